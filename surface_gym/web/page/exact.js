/**
 * Sine, cosine and the length of a vector, to the bit as Python has them on Linux.
 *
 * Browsers' own differ in the last bit for one argument in thirty. These follow the C library of
 * GNU, on processors that multiply and add at once (IBM Accurate Mathematical Library, 2001): a table
 * of sines and cosines for every 1/128 rad, and short series between. What a processor does at once is
 * done here by the exact sums and products of Dekker (1971).
 */

const SPLITTER = 134217729; // 2^27 + 1
const MOST = 1e8; // [rad] beyond which a browser's own do
const BIG = 52776558133248; // 1.5 2^45: added, it rounds to multiples of 1/128
const ROUND = 6755399441055744; // 1.5 2^52: added, it rounds to whole numbers
const PER_QUARTER = 0.6366197723675814; // 2 / pi
// Half of pi in parts.
const HALF_PI = [1.5707963267948966, 6.123233995736766e-17];
const PARTS = [
  1.5707963407039642, -1.3909067564377153e-8, -4.97899623147991e-17, -1.9034889620193266e-25,
];
// Series of sine near 0, and of sine and cosine between the table's.
const SMALL = [
  -0.16666666666666666, 0.008333333333332329, -0.00019841269834414642, 2.7557298068607706e-6,
  -2.5022014848318398e-8,
];
const [SINE_3, SINE_5] = [-0.16666666666666488, 0.008333332142857223];
const [COSINE_2, COSINE_4, COSINE_6] = [0.5, -0.04166666666666644, 0.001388888740079376];

let low = 0; // of the last sum or product

function sum(a, b) {
  const high = a + b;
  const part = high - a;
  low = a - (high - part) + (b - part);
  return high;
}

function product(a, b) {
  const high = a * b;
  const bigA = SPLITTER * a;
  const bigB = SPLITTER * b;
  const aHigh = bigA - (bigA - a);
  const bHigh = bigB - (bigB - b);
  const aLow = a - aHigh;
  const bLow = b - bHigh;
  low = aLow * bLow - (high - aHigh * bHigh - aLow * bHigh - aHigh * bLow);
  return high;
}

/** Compute a b + c, rounded once. */
function fused(a, b, c) {
  const high = product(a, b);
  const highLow = low;
  const added = sum(high, c);
  return added + (low + highLow);
}

/** Sine and cosine of 0, 1/128, 2/128 ..., each as a number and what it lacks. */
const TABLE = new Float64Array(4 * 112);
for (let k = 0; k < 112; k++) {
  const x = k / 128; // the squares of whole numbers over 128 are exact
  for (const [place, first, start] of [
    [4 * k, x, 2],
    [4 * k + 2, 1, 1],
  ]) {
    let [total, totalLow, term, termLow] = [first, 0, first, 0];
    for (let n = start; n < 30; n += 2) {
      const by = -(x * x) / (n * (n + 1));
      const left = -(x * x) - product(by, n * (n + 1));
      const byLow = (left - low) / (n * (n + 1));
      const next = product(term, by);
      const nextLow = low + (term * byLow + termLow * by);
      term = sum(next, nextLow);
      termLow = low;
      const added = sum(total, term);
      totalLow += low + termLow;
      total = sum(added, totalLow);
      totalLow = low;
    }
    TABLE[place] = total;
    TABLE[place + 1] = totalLow;
  }
}

// Below, products and sums are rounded once only where it shows more often than in 1 of 10^8.

/** Cosine of x + dx, small. */
function smallCosine(x, dx) {
  const up = BIG + Math.abs(x);
  const rest = Math.abs(x) - (up - BIG) + (x < 0 ? -dx : dx);
  const k = 512 * (up - BIG);
  const square = rest * rest;
  const s = fused(rest * square, SINE_3 + square * SINE_5, rest);
  const c = square * (COSINE_2 + square * (COSINE_4 + square * COSINE_6));
  const more = TABLE[k + 3] - s * TABLE[k + 1];
  return TABLE[k + 2] + fused(-TABLE[k], s, fused(-TABLE[k + 2], c, more));
}

/** Sine of x + dx, small. */
function smallSine(x, dx) {
  if (Math.abs(x) < 0.126) {
    const square = x * x;
    const rest = SMALL[1] + square * (SMALL[2] + square * (SMALL[3] + square * SMALL[4]));
    const series = fused(rest, square, SMALL[0]);
    return x + (dx === 0 ? series * x * square : fused(fused(series, x, -0.5 * dx), square, dx));
  }
  const up = BIG + Math.abs(x);
  const rest = Math.abs(x) - (up - BIG);
  const off = x <= 0 ? -dx : dx;
  const k = 512 * (up - BIG);
  const square = rest * rest;
  const s = rest + fused(rest * square, SINE_3 + square * SINE_5, off);
  const c = rest * off + square * (COSINE_2 + square * (COSINE_4 + square * COSINE_6));
  const more = TABLE[k + 1] + s * TABLE[k + 3];
  const found = TABLE[k] + fused(TABLE[k + 2], s, fused(-TABLE[k], c, more));
  return x < 0 ? -found : found;
}

/** Sine of x and so many quarter turns. */
function turned(x, quarters) {
  const turns = x * PER_QUARTER + ROUND - ROUND;
  const y = x - turns * PARTS[0] - turns * PARTS[1]; // exact products
  const first = turns * PARTS[2];
  const near = y - first;
  const nearLow = y - near - first;
  const second = turns * PARTS[3];
  const angle = near - second;
  const angleLow = nearLow + (near - angle - second);
  const quadrant = (((turns + quarters) % 4) + 4) % 4;
  const found = quadrant % 2 ? smallCosine(angle, angleLow) : smallSine(angle, angleLow);
  return quadrant > 1 ? -found : found;
}

/** Sine of an angle [rad]. */
export function sin(x) {
  const size = Math.abs(x);
  if (size < 2 ** -26) return x;
  if (size < 0.85546875) return smallSine(x, 0);
  if (size < 2.426265) {
    const found = smallCosine(HALF_PI[0] - size, HALF_PI[1]);
    return x < 0 ? -found : found;
  }
  return size < MOST ? turned(x, 0) : Math.sin(x);
}

/** Cosine of an angle [rad]. */
export function cos(x) {
  const size = Math.abs(x);
  if (size < 2 ** -27) return 1;
  if (size < 0.85546875) return smallCosine(x, 0);
  if (size < 2.426265) {
    const y = HALF_PI[0] - size;
    const near = y + HALF_PI[1];
    return smallSine(near, y - near + HALF_PI[1]);
  }
  return size < MOST ? turned(x, 1) : Math.cos(x);
}

/** Length of a vector. */
export function hypot(x, y) {
  const length = Math.sqrt(x * x + y * y);
  if (!(length > 0)) return length;
  const [squareX, lowX] = [product(x, x), low];
  const [squareY, lowY] = [product(y, y), low];
  const whole = sum(squareX, squareY);
  const wholeLow = low + (lowX + lowY);
  const square = product(length, length);
  return length + (whole - square + (wholeLow - low)) / (2 * length);
}
