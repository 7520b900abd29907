/** Parcels as the physics reads them: numbers, edges and corners of their bases; and overlaps. */

import { cos, ensure, hypot, sin } from "./machine.js";

const NO_EDGE = [0, 1, 1e9]; // that no point lies beyond
const MOST_CORNERS = 32;
const SIZE = [0.02, 2]; // [m]
const MASS = [0.001, 10000]; // [kg]

/**
 * @typedef {object} Base one of
 * @property {number[]} [rectangle] length, width [m]
 * @property {number} [disc] radius [m]
 * @property {number[][]} [polygon] corners [m] of a convex one, in its own frame
 *
 * @typedef {object} Parcel
 * @property {Base} base
 * @property {number} mass [kg]
 * @property {number} com_height [m] of the centre of mass
 * @property {number[]} com_offset [m] centre of mass from the base's centroid
 *
 * @typedef {object} Body
 * @property {number[]} row as the physics holds it: radius, load's x, y, height, gyration, rear, mass
 * @property {number[][]} edges outward normals and distances [m] from the centroid; none of a disc
 * @property {number[][]} corners [m] from the centroid; a disc's only one lies there
 * @property {number[]} centre [m] of mass, in the base's frame
 * @property {number} mass [kg]
 * @property {number} radius [m] of the circle around the centroid that holds the base
 */

/** Check that a value is a finite number between two bounds. */
export function checkNumber(name, value, least, most) {
  ensure(Number.isFinite(value), `${name} must be a finite number, got ${shown(value)}.`);
  const isWithin = value >= least && value <= most;
  ensure(isWithin, `${name} must be from ${least} to ${most}, got ${value}.`);
  return value;
}

/** Check that a value is an array of so many elements. */
export function checkArray(name, value, least, most = least) {
  ensure(Array.isArray(value), `${name} must be an array, got ${shown(value)}.`);
  const wanted = least === most ? least : `${least} to ${most}`;
  const isWithin = value.length >= least && value.length <= most;
  ensure(isWithin, `${name} must hold ${wanted} values, got ${value.length}.`);
  return value;
}

/** Check that a value is an array of so many numbers between two bounds. */
export function checkNumbers(name, value, many, least, most) {
  for (const each of checkArray(name, value, many)) checkNumber(name, each, least, most);
  return value;
}

/** Write a value for a message, cut short. */
export function shown(value) {
  const text = value === undefined ? "nothing" : JSON.stringify(value);
  return text.length > 40 ? `${text.slice(0, 40)}…` : text;
}

/** Make the body of a parcel, or say what is wrong with it. @returns {Body} */
export function makeBody(parcel, name = "parcel") {
  const { base, mass, com_height: height = 0.1, com_offset: offset = [0, 0] } = parcel;
  checkNumber(`${name}.mass`, mass, ...MASS);
  checkNumber(`${name}.com_height`, height, 0, 10);
  checkNumbers(`${name}.com_offset`, offset, 2, -SIZE[1], SIZE[1]);
  const { corners, edges, radius, gyration, centroid } = readBase(base ?? {}, name);
  const rear = edges.length ? -Math.min(...corners.map(([x]) => x)) : radius;
  const isOver = edges.length
    ? edges.every(([nx, ny, d]) => nx * offset[0] + ny * offset[1] <= d)
    : hypot(...offset) <= radius;
  ensure(isOver, `${name}.com_offset must keep the load over the base, got ${shown(offset)}.`);
  const row = [radius, offset[0], offset[1], height, gyration, rear, mass];
  return {
    row,
    edges,
    corners,
    centre: [centroid[0] + offset[0], centroid[1] + offset[1]],
    mass,
    radius,
  };
}

function readBase(base, name) {
  if (base.rectangle !== undefined) {
    const [length, width] = checkNumbers(`${name}.rectangle`, base.rectangle, 2, ...SIZE);
    const [b, h] = [length / 2, width / 2];
    return {
      corners: [
        [-b, -h],
        [b, -h],
        [b, h],
        [-b, h],
      ],
      edges: [
        [1, 0, b],
        [-1, 0, b],
        [0, 1, h],
        [0, -1, h],
      ],
      radius: hypot(length, width) / 2,
      gyration: (length * length + width * width) / 12,
      centroid: [0, 0],
    };
  }
  if (base.disc !== undefined) {
    const radius = checkNumber(`${name}.disc`, base.disc, SIZE[0] / 2, SIZE[1] / 2);
    return {
      corners: [[0, 0]],
      edges: [],
      radius,
      gyration: (radius * radius) / 2,
      centroid: [0, 0],
    };
  }
  ensure(
    base.polygon !== undefined,
    `${name}.base must be a rectangle, a disc or a polygon, got ${shown(base)}.`,
  );
  return readPolygon(base.polygon, `${name}.polygon`);
}

function readPolygon(vertices, name) {
  checkArray(name, vertices, 3, MOST_CORNERS);
  for (const vertex of vertices) checkNumbers(name, vertex, 2, -SIZE[1], SIZE[1]);
  const next = (list, k) => list[(k + 1) % list.length];
  const signed = vertices.reduce(
    (sum, [x, y], k) => sum + x * next(vertices, k)[1] - y * next(vertices, k)[0],
    0,
  );
  const outline = signed > 0 ? vertices : [...vertices].reverse();
  let turned = 0;
  for (const [k, [x, y]] of outline.entries()) {
    const [after, beyond] = [next(outline, k), next(outline, (k + 1) % outline.length)];
    const [ax, ay] = [after[0] - x, after[1] - y];
    const [bx, by] = [beyond[0] - after[0], beyond[1] - after[1]];
    const turn = Math.atan2(ax * by - ay * bx, ax * bx + ay * by);
    turned += turn > -1e-9 && hypot(ax, ay) > 0 ? turn : Number.NaN;
  }
  const isConvex = Math.abs(turned - 2 * Math.PI) <= 1e-6;
  ensure(isConvex, `${name} must be convex, its corners in order.`);
  const size = Math.abs(signed / 2);
  ensure(size >= SIZE[0] ** 2, `${name} must be larger: it has ${size.toPrecision(2)} m².`);
  const [x0, y0] = outline[0];
  const start = outline.map(([x, y]) => [x - x0, y - y0]);
  let [area, sumX, sumY, squares] = [0, 0, 0, 0];
  for (const [k, [x, y]] of start.entries()) {
    const [endX, endY] = next(start, k);
    const twice = x * endY - endX * y;
    area += twice;
    sumX += twice * (x + endX);
    sumY += twice * (y + endY);
    squares += twice * (x * x + x * endX + endX * endX + y * y + y * endY + endY * endY);
  }
  const centroid = [x0 + sumX / (3 * area), y0 + sumY / (3 * area)];
  const [offX, offY] = [centroid[0] - x0, centroid[1] - y0];
  const corners = outline.map(([x, y]) => [x - centroid[0], y - centroid[1]]);
  const edges = corners.map(([x, y], k) => {
    const [sideX, sideY] = [next(corners, k)[0] - x, next(corners, k)[1] - y];
    const length = hypot(sideX, sideY);
    const [nx, ny] = [sideY / length, -sideX / length];
    return [nx, ny, nx * x + ny * y];
  });
  return {
    corners,
    edges,
    radius: Math.max(...corners.map((corner) => hypot(...corner))),
    gyration: squares / (6 * area) - (offX * offX + offY * offY),
    centroid,
  };
}

/** Write bodies into the arrays of a machine whose names begin so, each made as large as it must. */
export function writeBodies(machine, prefix, bodies, rows) {
  const sides = Math.max(3, ...bodies.map(({ corners }) => corners.length));
  machine.resize(`${prefix}body`, [rows, 7]);
  machine.resize(`${prefix}edges`, [rows, sides, 3]);
  machine.resize(`${prefix}corners`, [rows, sides, 2]);
  const [body, edge, corner] = ["body", "edges", "corners"].map((name) =>
    machine.view(prefix + name),
  );
  for (const [k, { row, edges, corners }] of bodies.entries()) {
    body.set(row, 7 * k);
    for (let side = 0; side < sides; side++) {
      edge.set(edges[side] ?? NO_EDGE, 3 * (sides * k + side));
      corner.set(corners[side] ?? corners[0], 2 * (sides * k + side));
    }
  }
}

/** The state of the centre of mass where the base's frame has a pose and a velocity. */
export function toCentre({ centre: [cx, cy] }, [x, y, theta], [vx, vy, omega]) {
  const [cosine, sine] = [cos(theta), sin(theta)];
  const [armX, armY] = cx || cy ? [cosine * cx - sine * cy, sine * cx + cosine * cy] : [0, 0];
  return [x + armX, y + armY, theta, vx - omega * armY, vy + omega * armX, omega, 0, 0];
}

/** Pose and velocity of the base's frame, by the state of the centre of mass. */
export function toFrame({ centre: [cx, cy] }, [x, y, theta, vx, vy, omega]) {
  if (!cx && !cy) return [x, y, theta, vx, vy, omega];
  const [cosine, sine] = [cos(theta), sin(theta)];
  const [armX, armY] = [cosine * cx - sine * cy, sine * cx + cosine * cy];
  return [x - armX, y - armY, theta, vx + omega * armY, vy - omega * armX, omega];
}

/** Corners of a base in its own frame; null of a disc. */
export function outlineOf({ edges, corners, centre, row }) {
  if (!edges.length) return null;
  const [x, y] = [centre[0] - row[1], centre[1] - row[2]];
  return corners.map((corner) => [corner[0] + x, corner[1] + y]);
}

/** Compute how far [m] two bases are apart along the best of their edges; negative: they overlap. */
export function distance(one, onePose, other, otherPose) {
  const [a, b] = [place(one, onePose), place(other, otherPose)];
  const between = [b.middle[0] - a.middle[0], b.middle[1] - a.middle[1]];
  const corners = [...(a.corners ?? []), ...(b.corners ?? [])];
  const discs = [a, b].filter((each) => !each.corners);
  const toCorners = ({ middle }) => corners.map(([x, y]) => [x - middle[0], y - middle[1]]);
  const normals = [...a.normals, ...b.normals];
  for (const [dx, dy] of [between, ...discs.flatMap(toCorners)]) {
    const length = hypot(dx, dy);
    if (length > 0) normals.push([dx / length, dy / length]);
  }
  return Math.max(...normals.map(([nx, ny]) => Math.max(gap(a, b, nx, ny), gap(b, a, nx, ny))));
}

function gap(a, b, nx, ny) {
  return -reach(b, -nx, -ny) - reach(a, nx, ny);
}

function reach({ corners, middle, radius }, nx, ny) {
  if (!corners) return middle[0] * nx + middle[1] * ny + radius;
  return Math.max(...corners.map(([x, y]) => x * nx + y * ny));
}

function place(body, [x, y, theta]) {
  const [cosine, sine] = [cos(theta), sin(theta)];
  const at = ([px, py]) => [x + cosine * px - sine * py, y + sine * px + cosine * py];
  const outline = outlineOf(body);
  return {
    middle: at([body.centre[0] - body.row[1], body.centre[1] - body.row[2]]),
    radius: body.radius,
    corners: outline?.map(at) ?? null,
    normals: body.edges.map(([nx, ny]) => [cosine * nx - sine * ny, sine * nx + cosine * ny]),
  };
}
