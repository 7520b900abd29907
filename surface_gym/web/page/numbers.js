/** Numbers, computed as NumPy computes them. */

/** Sum numbers in the order in which NumPy does. */
export function sum(values, first = 0, count = values.length) {
  if (count < 8) {
    let found = -0;
    for (let k = first; k < first + count; k++) found += values[k];
    return found;
  }
  if (count > 128) {
    const half = Math.floor(count / 16) * 8;
    return sum(values, first, half) + sum(values, first + half, count - half);
  }
  const [a, b, c, d, e, f, g, h] = [0, 1, 2, 3, 4, 5, 6, 7].map((lane) => {
    let found = values[first + lane];
    for (let k = lane + 8; k < count - (count % 8); k += 8) found += values[first + k];
    return found;
  });
  let found = a + b + (c + d) + (e + f + (g + h));
  for (let k = count - (count % 8); k < count; k++) found += values[first + k];
  return found;
}

/** Keep a number within bounds. */
export const clip = (value, least, most) => Math.min(Math.max(value, least), most);

/** Find the place of the least number, the first of several. */
export const leastOf = (values) => values.indexOf(Math.min(...values));
