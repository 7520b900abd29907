/**
 * Slow and Stop by choosing, every period, the braking that ends nearest to the goal. The rules are
 * those of `agents/rules/braking.py`, whose numbers their cards hold, for what the page shows:
 * parcels taken as squares, and axes that turn at once.
 */

import { decodeLine } from "./decoding.js";
import { clip, leastOf, sum } from "./numbers.js";
import { Rule } from "./rule.js";

const [ROLL, HALF, FULL] = [0, 1, 2]; // level of a column: 90 deg; 45 and -45 deg in turn; 0 deg

/** Rows of elements under a parcel, as far as the base covers each. */
function contactSpan(card, seen) {
  const { columns, pitch, onEdge, isNarrow } = card;
  const rear = pitch[0] * columns - seen.rearToGo;
  const place = rear + seen.reach; // [m] x of the base's centroid past the zone's first edge
  const halfLength = Math.max(0.5 * (seen.frontInZone - rear), 0.5 * pitch[0]);
  const rows = card.rows + 2;
  const most = Math.floor(card.rows / 2);
  const under = Math.floor((seen.halfLength + onEdge) / pitch[1]);
  const halfRows = isNarrow ? clip(under, 1, most) : most;
  const [reach, rotor] = [new Float64Array(rows), new Array(rows)];
  for (let row = 0; row < rows; row++) {
    const fromMiddle = row - (rows - 1) / 2;
    const aside = Math.abs(pitch[1] * fromMiddle - seen.offset) / (seen.halfLength + onEdge);
    reach[row] = aside <= 1 ? halfLength + onEdge : -1;
    rotor[row] = Math.abs(fromMiddle) < halfRows;
  }
  const covered = reach.map((each) => Math.max(0, each));
  const ofRotors = covered.map((each, row) => (rotor[row] ? each : 0));
  const middle = 0.5 * (rear + seen.frontInZone) - place;
  return {
    place,
    middle,
    halfLength,
    firstColumn: Math.floor((place + middle - halfLength) / pitch[0]), // that it covers
    reach,
    rotor,
    rotorShare: sum(ofRotors) / Math.max(sum(covered), onEdge),
  };
}

/** A Kalman filter of friction along axes and across them. */
class FrictionEstimate {
  constructor({ unsure, least, most, predicted }, noise) {
    Object.assign(this, { least, most, predicted, noise });
    [this.along, this.across, this.both] = [1, 1, 0];
    [this.varAlong, this.varAcross] = unsure.map((each) => each * each);
  }

  get frictions() {
    return {
      braking: clip(this.along, this.least, this.most),
      rolling: clip(this.across, this.least, this.most),
      doubt: Math.sqrt(Math.max(0, this.varAcross)),
    };
  }

  /** Learn from the speed lost in a period, and what nominal friction would have taken of it. */
  update(lost, braking, rolling) {
    const withAlong = this.varAlong * braking + this.both * rolling;
    const withAcross = this.both * braking + this.varAcross * rolling;
    const share = this.predicted * braking;
    const doubt = this.noise * this.noise + share * share;
    const variance = withAlong * braking + withAcross * rolling + doubt;
    const surprise = (lost - this.along * braking - this.across * rolling) / variance;
    this.along += withAlong * surprise;
    this.across += withAcross * surprise;
    this.varAlong -= (withAlong * withAlong) / variance;
    this.varAcross -= (withAcross * withAcross) / variance;
    this.both -= (withAlong * withAcross) / variance;
  }
}

/** List the level of each column, the rearmost first, in each option; rolling is the first. */
function brakingOptions(columns) {
  const place = Array.from({ length: columns }, (_, k) => k);
  const parts = [
    ...place.map((first) => place.map((each) => each >= first)),
    ...place.slice(0, -1).map((first) => place.map((each) => each <= first)),
  ];
  const at = (level) => parts.map((part) => part.map((brakes) => (brakes ? level : ROLL)));
  return [place.map(() => ROLL), ...at(HALF), ...at(FULL)];
}

/** Compute the deceleration [m/s^2] where every column brakes half, and where all roll. */
function decelerations({ braking, rollingLoss, supportLoss, half }, share, frictions) {
  const supports = supportLoss * (1 - share);
  const [cosine, sine] = half;
  const slope = rollingLoss * cosine * share + supports;
  return {
    held: frictions.braking * braking * sine * share + frictions.rolling * slope,
    rolled: frictions.rolling * (rollingLoss * share + supports),
  };
}

class BrakingRule extends Rule {
  begin(run) {
    const [exact, other] = this.card.noises;
    this.estimate = new FrictionEstimate(this.card, run.noise ? other : exact);
    this.before = null; // speed, and what braking and rolling would take of it in the period
  }

  choose(observation) {
    const { card, estimate, before } = this;
    const seen = decodeLine(card, observation);
    if (before) estimate.update(before.speed - seen.vx, before.braking, before.rolling);
    const { frictions } = estimate;
    const span = contactSpan(card, seen);
    const options = this.levels(seen, span);
    const after = options.map((levels) => this.predict(span, seen.vx, frictions, levels));
    const best = leastOf(this.regrets(seen, span, frictions, after));
    this.before = { speed: seen.vx, braking: after[best].braking, rolling: after[best].rolling };
    const { rows, columns, choices } = card;
    return Array.from(
      { length: rows * columns },
      (_, part) => choices[options[best][part % columns]][Math.floor(part / columns)],
    );
  }

  /** List the zone's columns in each option of braking. */
  levels(seen, span) {
    const { columns, pitch, period } = this.card;
    const ahead = Math.max(0, seen.vx) * period;
    const reached = Math.ceil((2 * span.halfLength + ahead) / pitch[0]) + 1;
    return brakingOptions(reached).map((option) =>
      Array.from({ length: columns }, (_, column) => option[column - span.firstColumn] ?? ROLL),
    );
  }

  /** Predict place and speed a period on, and what takes the speed where friction is nominal. */
  predict(span, speed, frictions, levels) {
    const { dt, steps, leans, pitch, braking, rollingLoss, supportLoss } = this.card;
    const longest = 2 * span.halfLength + Math.max(0, speed) * dt * steps;
    const count = Math.ceil(longest / pitch[0]) + 2;
    const near = Array.from({ length: count }, (_, k) => span.firstColumn + k);
    const lean = near.map((column) => leans[levels[column] ?? ROLL]); // beyond the zone all roll
    const found = { place: span.place, speed, braking: 0, rolling: 0 };
    let loss = 0;
    for (let step = 0; step < steps; step++) {
      const arm = near.map(
        (column) => pitch[0] * (column + 0.5) - (found.place + 0.5 * dt * found.speed),
      );
      const bearing = countUnder(span, arm);
      const perRotor = this.shareLoad(arm, bearing.elements, loss);
      const perElement = perRotor.map((each, k) => each * bearing.elements[k]);
      const ofRotors = perRotor.map((each, k) => each * bearing.rotors[k]);
      const brake = braking * sum(ofRotors.map((each, k) => each * lean[k][1]));
      let roll = rollingLoss * sum(ofRotors.map((each, k) => each * lean[k][0]));
      roll += supportLoss * sum(perElement.map((each, k) => each - ofRotors[k]));
      loss = frictions.braking * brake + frictions.rolling * roll;
      const slower = Math.max(0, found.speed - dt * loss);
      found.place += 0.5 * dt * (found.speed + slower);
      found.speed = slower;
      found.braking += dt * brake;
      found.rolling += dt * roll;
    }
    return found;
  }

  /** Share the weight among the elements of each column, as Eq. (1) does, cut off at nothing. */
  shareLoad(arm, elements, before) {
    const { comHeight, gravity } = this.card;
    const count = Math.max(1, sum(elements));
    const mean = sum(elements.map((many, k) => many * arm[k])) / count;
    const apart = arm.map((each) => each - mean);
    const spread = Math.max(sum(elements.map((many, k) => many * (apart[k] * apart[k]))), 1e-9);
    const slope = ((before * comHeight) / gravity - mean) / spread;
    const load = apart.map((each, k) =>
      elements[k] > 0 ? Math.max(0, 1 / count + each * slope) : 0,
    );
    const weight = Math.max(sum(load.map((each, k) => each * elements[k])), 1e-9);
    return load.map((each) => each / weight);
  }
}

/** Count the elements and the rotors of each column that bear. */
function countUnder({ reach, rotor, middle }, arm) {
  const far = arm.map((each) => Math.abs(each - middle));
  const count = (is) =>
    far.map((each) => reach.filter((most, row) => each <= most && is(row)).length);
  return { elements: count(() => true), rotors: count((row) => rotor[row]) };
}

/** Slow: roll, then brake as much as leaves no speed short of the asked ratio. */
export class SlowingRule extends BrakingRule {
  regrets(seen, span, frictions, after) {
    const { card } = this;
    const found = decelerations(card, span.rotorShare, frictions);
    const rolled = found.rolled * (1 + card.caution * frictions.doubt);
    const asked = seen.ratio * seen.entrySpeed;
    const toGo = ({ place }) => Math.max(0, span.place + seen.rearToGo - place);
    const regrets = after.map((each) => {
      const excess = each.speed - Math.sqrt(asked * asked + 2 * rolled * toGo(each));
      return excess < 0 ? -card.short * excess : excess;
    });
    const [rolling] = after;
    const braked = 2 * card.gently * found.held;
    const over = toGo(rolling) - (rolling.speed * rolling.speed - asked * asked) / braked;
    if (over > card.trimTime * asked) regrets[0] = 0;
    return regrets;
  }
}

/** Stop: brake so that going on at a part of half braking comes to rest at the asked x. */
export class StoppingRule extends BrakingRule {
  regrets(seen, span, frictions, after) {
    const held = this.card.gently * decelerations(this.card, span.rotorShare, frictions).held;
    const asked = span.place + seen.toGo;
    return after.map(({ place, speed }) => Math.abs(place + (speed * speed) / (2 * held) - asked));
  }
}
