/**
 * Rules that predict the motion of a period: sliding mode along a path, and turning. They are those
 * of `agents/rules/steering.py`, whose numbers their cards hold.
 */

import { decodeLine, decodePath, linePositions, windowPositions } from "./decoding.js";
import { sin } from "./machine.js";
import { clip, leastOf, sum } from "./numbers.js";
import { Rule } from "./rule.js";

/** An evenly loaded square on modules, with friction along axes. */
class SquareModel {
  constructor(card, modules, { halfLength, tilt = 0 }) {
    const { braking, gravity } = card;
    this.card = card;
    this.modules = modules;
    this.gyration = (2 / 3) * (halfLength * halfLength); // [m^2] of a square
    const under = modules.under.filter((is) => is).length;
    this.braking = modules.under.map((is) => braking * ((is ? 1 : 0) / Math.max(1, under)));
    this.pull = gravity * sin(tilt);
  }

  /** Predict the motion a period on. @param {ArrayLike<number>} option choice of each module */
  predict(motion, option) {
    const { gyration, pull } = this;
    const { steps, period, braking, directions } = this.card;
    const { x, y } = this.modules;
    const dt = period / steps;
    let { vx, vy, omega } = motion;
    const count = option.length;
    const [arm, soft] = [new Float64Array(count), new Float64Array(count)];
    for (let k = 0; k < count; k++) {
      const [cosine, sine] = directions[option[k]];
      arm[k] = x[k] * sine - y[k] * cosine;
      // Friction grows to its most over the speed that a step of it takes: it overshoots none.
      soft[k] = braking * dt * (1 + (arm[k] * arm[k]) / gyration);
    }
    const [byX, byY, byArm] = [1, 2, 3].map(() => new Float64Array(count));
    for (let step = 0; step < steps; step++) {
      for (let k = 0; k < count; k++) {
        const [cosine, sine] = directions[option[k]];
        const slip = vx * cosine + vy * sine + omega * arm[k];
        const taken = dt * this.braking[k] * clip(slip / soft[k], -1, 1);
        byX[k] = taken * cosine;
        byY[k] = taken * sine;
        byArm[k] = taken * arm[k];
      }
      vx = vx + dt * pull - sum(byX);
      vy = vy - sum(byY);
      omega = omega - sum(byArm) / gyration;
    }
    return { vx, vy, omega };
  }
}

/** Track: sliding along the surface of speed across the path and error across it. */
export class SlidingMode extends Rule {
  choose(observation) {
    const { card } = this;
    const seen = decodePath(card, observation);
    const model = new SquareModel(card, windowPositions(card, seen), seen);
    const regrets = card.options.map((option) => this.regret(seen, model.predict(seen, option)));
    return card.options[leastOf(regrets)];
  }

  regret(seen, after) {
    const { period, ahead, surfaceSlope, speedWeight, turnWeight, straightening } = this.card;
    // The path's heading where the parcel will be.
    const share = clip((seen.vx * period) / ahead, 0, 1);
    const slope = seen.slope[0] + share * (seen.slope[1] - seen.slope[0]);
    const cosine = 1 / Math.sqrt(1 + slope * slope);
    const sine = slope * cosine;
    const along = cosine * after.vx + sine * after.vy;
    const across = cosine * after.vy - sine * after.vx;
    const mean = 0.5 * (seen.crossSpeed + across);
    const off = across + surfaceSlope * (seen.crossError + period * mean);
    const late = along - seen.askedSpeed;
    const turn = after.omega + straightening * (seen.theta + period * after.omega);
    const edge = seen.halfLength * turn;
    return off * off + speedWeight * (late * late) + turnWeight * (edge * edge);
  }
}

/** Orient: 45 deg one way ahead of the centre and the other way behind it turn the parcel. */
export class TurningRule extends Rule {
  choose(observation) {
    const { card } = this;
    const seen = decodeLine(card, observation);
    const modules = linePositions(card, seen);
    const model = new SquareModel(card, modules, seen);
    const options = this.options(seen, modules);
    const regrets = options.map((option) => this.regret(seen, model.predict(seen, option)));
    regrets[0] -= card.worthIt;
    return options[leastOf(regrets)];
  }

  options(seen, { x }) {
    const { axes, from } = this.card;
    const { roll, left, right } = axes;
    const found = [Array.from(x, () => roll)];
    const turning = (front, rear) => {
      for (const share of from) {
        const start = share * seen.halfLength;
        const ahead = (place) => seen.isWhollyInZone && place > start;
        const behind = (place) => seen.isWhollyInZone && place < -start;
        found.push(Array.from(x, (place) => (ahead(place) ? front : behind(place) ? rear : roll)));
      }
    };
    for (const [front, rear] of [
      [left, right],
      [right, left],
    ]) {
      turning(front, rear);
      turning(front, roll);
      turning(roll, rear);
    }
    return found;
  }

  regret(seen, after) {
    const { period, endOfTurn, closeEnough, speedWorth, driftWorth } = this.card;
    const turn = 0.5 * period * (seen.omega + after.omega);
    const end = after.omega * Math.abs(after.omega) * seen.halfLength;
    const left = seen.angle - seen.theta - turn - end / (2 * endOfTurn);
    const off = Math.max(0, Math.abs(left) - closeEnough);
    return off - speedWorth * after.vx + driftWorth * Math.abs(after.vy);
  }
}
