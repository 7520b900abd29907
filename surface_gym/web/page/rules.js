/** Rules of one parcel that choose anew each control period, by their kind. */

import { SlowingRule, StoppingRule } from "./braking.js";
import { decodeLine } from "./decoding.js";
import { PidRule, ThresholdRule } from "./local.js";
import { Rule } from "./rule.js";
import { SlidingMode, TurningRule } from "./steering.js";

/** Sort: 90 deg until the parcel is wholly in the zone, then 45 deg everywhere. */
class EventRule extends Rule {
  choose(observation, run) {
    const { axes } = this.card;
    const { isWhollyInZone, side } = decodeLine(this.card, observation);
    let choice = axes.roll;
    if (isWhollyInZone && side !== 0) choice = side > 0 ? axes.left : axes.right;
    return run.wanted.map(() => choice);
  }
}

const KINDS = {
  event: EventRule,
  threshold: ThresholdRule,
  pid: PidRule,
  sliding: SlidingMode,
  turning: TurningRule,
  slowing: SlowingRule,
  stopping: StoppingRule,
};

/** Make a rule of its card. @param {import("./rule.js").Card} card @returns {Rule} */
export function makeRule(card) {
  return new KINDS[card.kind](card);
}
