/** Tracks of parcels: what a run records of each. */

const MOST = 400; // points of a way that are drawn

/**
 * @typedef {object} Track of a parcel
 * @property {number} number 1, 2 ...
 * @property {number[]} times [s]
 * @property {number[]} motion x, y, theta, vx, vy, omega of the base at each time, in a row
 */

/** Choose points of a way to draw, not too many, from its motion. */
export function thinned(motion) {
  const count = motion.length / 6;
  const every = Math.max(1, Math.ceil(count / MOST));
  const points = [];
  for (let k = 0; k < count; k += every) points.push([motion[6 * k], motion[6 * k + 1]]);
  points.push([motion[motion.length - 6], motion[motion.length - 5]]);
  return points;
}
