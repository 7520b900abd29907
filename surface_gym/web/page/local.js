/**
 * Rules by which each module decides for itself: thresholds, and a PID controller each. They are
 * those of `agents/rules/local.py`, whose numbers their cards hold.
 */

import { decodeLine, decodePath, linePositions, windowPositions } from "./decoding.js";
import { clip } from "./numbers.js";
import { Rule } from "./rule.js";

/** What a parcel should do in each task. */
const WANTED = {
  /** Straight on until it is wholly in the zone, then off to the asked side. */
  sort(seen, { aside, centring, straightening }) {
    const side = seen.isWhollyInZone ? seen.side : 0;
    const vy = side !== 0 ? aside * side : -centring * seen.offset;
    return { vx: seen.vx, vy, omega: -straightening * seen.theta };
  },

  /** Straight on until it is wholly in the zone, then turning to the asked angle. */
  orient(seen, { closeEnough, endOfTurn, turning }) {
    const left = seen.angle - seen.theta;
    const size = Math.abs(left) > closeEnough ? Math.abs(left) : 0;
    const fastest = Math.sqrt(((2 * endOfTurn) / seen.halfLength) * size);
    const omega = Math.sign(left) * Math.min(turning * size, fastest);
    return { vx: seen.vx, vy: seen.vy, omega: seen.isWhollyInZone ? omega : 0 };
  },

  /** Along the path at the asked speed, back to the path, and not turned. */
  track(seen, { crossing, straightening }) {
    const cosine = 1 / Math.sqrt(1 + seen.slope[1] * seen.slope[1]);
    const sine = seen.slope[1] * cosine;
    const across = -crossing * seen.crossError;
    return {
      vx: seen.askedSpeed * cosine - across * sine,
      vy: seen.askedSpeed * sine + across * cosine,
      omega: -straightening * seen.theta,
    };
  },
};

/**
 * @typedef {object} LocalCard
 * @property {string} task
 * @property {[number, number]} thresholds [m/s]
 * @property {[number, number, number]} gains of a PID: [-], [1/s], [s]
 */

/** A rule of modules by the error above each alone: the velocity there should be, less what is. */
class LocalRule extends Rule {
  choose(observation) {
    const { card } = this;
    const isPath = card.task === "track";
    const seen = (isPath ? decodePath : decodeLine)(card, observation);
    const modules = (isPath ? windowPositions : linePositions)(card, seen);
    const wanted = WANTED[card.task](seen, card);
    const above = ({ vx, vy, omega }, part) => [
      vx - omega * modules.y[part],
      vy + omega * modules.x[part],
    ];
    return modules.under.map((isUnder, part) => {
      const velocity = above(seen, part);
      const asked = above(wanted, part);
      const error = [asked[0] - velocity[0], asked[1] - velocity[1]];
      return this.turn(part, velocity, error, isUnder);
    });
  }
}

export class ThresholdRule extends LocalRule {
  turn(_part, _velocity, [along, across]) {
    const { thresholds, axes } = this.card;
    const [aside, ahead] = thresholds;
    if (across > aside) return axes.left;
    if (across < -aside) return axes.right;
    return along < -ahead ? axes.brake : axes.roll;
  }
}

export class PidRule extends LocalRule {
  begin() {
    this.summed = new Map(); // of each module, as is its last error
    this.last = new Map();
  }

  turn(part, velocity, error, isUnder) {
    const { gains, period, mostSummed, directions, braking } = this.card;
    const [proportional, integral, derivative] = gains;
    const before = this.summed.get(part) ?? [0, 0];
    const last = this.last.get(part) ?? error;
    const summed = error.map((value, k) =>
      isUnder ? clip(before[k] + period * value, -mostSummed, mostSummed) : 0,
    );
    this.summed.set(part, summed);
    this.last.set(part, error);
    const wanted = error.map((value, k) => {
      const change = (derivative * (value - last[k])) / period;
      return proportional * value + integral * summed[k] + change;
    });
    const most = braking * period; // friction brakes along an axis, and at most to rest
    let [best, least] = [0, Infinity];
    directions.forEach(([x, y], choice) => {
      const along = clip(velocity[0] * x + velocity[1] * y, -most, most);
      const miss = [wanted[0] + along * x, wanted[1] + along * y];
      const size = miss[0] * miss[0] + miss[1] * miss[1];
      if (size < least) [best, least] = [choice, size];
    });
    return best;
  }
}
