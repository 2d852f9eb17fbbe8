// The ant on its floor, seen from behind, and where one can take hold of it.

import { limited, mix, polygon } from "./scene.js";

const TORSO_RADIUS = 0.25; // m
const EYE = [-3.7, -1.3, 1.1]; // m, seen from the place that it looks at
const LOOKS_AT = 0.4; // m above the floor
const NEAR = 0.4; // m
const FAR = 26; // m, of the floor's tiles
const MARKS = 5; // m between them

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const along = (a, share, b) => a.map((value, i) => value + share * b[i]);

function turnedBy([x, y, z, w], v) {
  const cross = (a, b) => [
    a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const t = cross([x, y, z], v).map((value) => 2 * value);
  return along(along(v, w, t), 1, cross([x, y, z], t));
}

class AntCamera {
  constructor() {
    this.ready = false;
    this.x = this.y = 0; // m
    this.width = this.height = this.pixels = 0; // pixels of an m that is 1 m away
    const [x, y, z] = EYE, flat = Math.hypot(x, y), far = Math.hypot(x, y, z);
    this.ahead = [-x / far, -y / far, -z / far];
    this.right = [-y / flat, x / flat, 0];
    this.up = [(-x / flat) * (z / far), (-y / flat) * (z / far), flat / far];
  }

  follow(_, torso, width, height) {
    this.y = this.ready ? mix(this.y, torso.y, 0.08) : torso.y;
    this.x = torso.x;
    this.ready = true;
    this.eye = [this.x + EYE[0], this.y + EYE[1], LOOKS_AT + EYE[2]];
    this.width = width;
    this.height = height;
    this.pixels = Math.min(1.6 * height, 1.35 * width);
  }

  /** A point as the eye sees it: to the right, up and ahead, in m. */
  seen([x, y, z]) {
    const from = [x - this.eye[0], y - this.eye[1], z - this.eye[2]];
    return [dot(from, this.right), dot(from, this.up), dot(from, this.ahead)];
  }
  flat(seen) {
    const [right, up, ahead] = seen;
    const scale = this.pixels / ahead;
    return [this.width / 2 + right * scale, this.height / 2 - up * scale];
  }
  toPixels(point) { return this.flat(this.seen(point)); }
  scaleAt(point) { return this.pixels / this.seen(point)[2]; } // pixels a m
  get horizon() { return this.height / 2 + (this.pixels * this.ahead[2]) / Math.hypot(this.ahead[0], this.ahead[1]); }

  /** A polygon of points as `seen`, in pixels, without what is behind the eye. */
  clipped(seen) {
    if (seen.every(([, , ahead]) => ahead > NEAR)) return seen.map((point) => this.flat(point));
    return seen.flatMap((to, i) => {
      const from = seen.at(i - 1), kept = to[2] > NEAR ? [to] : [];
      if (from[2] > NEAR === to[2] > NEAR) return kept;
      const share = (NEAR - from[2]) / (to[2] - from[2]);
      return [from.map((value, k) => mix(value, to[k], share)), ...kept];
    }).map((point) => this.flat(point));
  }
}

function blendAnt(before, after, share) {
  return after.map((part, i) => {
    const from = before[i], same = from.turn.reduce((sum, q, k) => sum + q * part.turn[k], 0);
    const turn = part.turn.map((q, k) => mix(same < 0 ? -from.turn[k] : from.turn[k], q, share));
    const length = Math.hypot(...turn);
    return {
      x: mix(from.x, part.x, share), y: mix(from.y, part.y, share), z: mix(from.z, part.z, share),
      turn: turn.map((q) => q / length),
    };
  });
}

/** The twelve parts of the legs: leg and part by number, both ends, radius. In m. */
function capsules({ design, task: { originals } }, parts) {
  return parts.slice(1).map(({ x, y, z, turn }, i) => {
    const leg = Math.floor(i / 3), k = i % 3, size = (n) => design[9 * leg + n] * originals[9 * leg + n];
    const from = [x, y, z];
    const to = along(from, 1, turnedBy(turn, [size(2 * k), size(2 * k + 1), 0]));
    return { leg, k, turn, from, to, radius: size(6 + k) };
  });
}

function drawFloor(context, camera, colors) {
  const { width, height, horizon } = camera;
  const sky = context.createLinearGradient(0, 0, 0, Math.max(horizon, 1));
  sky.addColorStop(0, colors.sky);
  sky.addColorStop(1, colors["sky-low"]);
  context.fillStyle = sky;
  context.fillRect(0, 0, width, height);
  const shade = (color) => { // out of the haze
    const found = context.createLinearGradient(0, horizon, 0, height);
    found.addColorStop(0, colors["sky-low"]);
    found.addColorStop(0.3, color);
    return found;
  };
  context.fillStyle = shade(colors.floor);
  context.fillRect(0, horizon, width, height - horizon);
  context.beginPath();
  const x0 = Math.floor(camera.x) - 4, y0 = Math.floor(camera.y) - FAR / 2;
  const rows = Array.from({ length: FAR + 1 }, (_, x) =>
    Array.from({ length: FAR + 1 }, (_, y) => camera.seen([x0 + x, y0 + y, 0])));
  for (let x = 0; x < FAR; x++)
    for (let y = (x0 + x + y0) & 1; y < FAR; y += 2)
      camera.clipped([rows[x][y], rows[x + 1][y], rows[x + 1][y + 1], rows[x][y + 1]])
        .forEach(([px, py], i) => (i ? context.lineTo(px, py) : context.moveTo(px, py)));
  context.fillStyle = shade(colors.tile);
  context.fill();
}

function drawDistances(context, camera, colors) {
  context.textAlign = "center";
  context.fillStyle = context.strokeStyle = colors.label;
  for (let x = MARKS * Math.ceil((camera.x - 2) / MARKS); x < camera.x + 12; x += MARKS) {
    if (x < 0) continue;
    const [left, right] = [[x, camera.y + 2], [x, camera.y - 2]].map(([a, b]) => [a, b, 0]);
    if (camera.seen(right)[2] < NEAR) continue;
    const size = Math.min(22, 0.16 * camera.scaleAt(right)), [px, py] = camera.toPixels(right);
    context.lineWidth = Math.max(1, size / 8);
    context.beginPath();
    context.moveTo(...camera.toPixels(left));
    context.lineTo(px, py);
    context.stroke();
    context.font = `${size}px system-ui, sans-serif`;
    context.fillText(`${x} m`, px + size * 1.6, py + size * 0.4);
  }
}

/** A capsule's outline: around one end, and back around the other. */
function outline(context, [ax, ay], a, [bx, by], b) {
  const angle = Math.atan2(by - ay, bx - ax);
  context.beginPath();
  context.arc(ax, ay, a, angle + Math.PI / 2, angle - Math.PI / 2);
  context.arc(bx, by, b, angle - Math.PI / 2, angle + Math.PI / 2);
  context.closePath();
}

function drawShadow(context, camera, legs, torso) {
  context.fillStyle = context.strokeStyle = "#00000026";
  context.lineCap = context.lineJoin = "round";
  context.lineWidth = 0.12 * camera.scaleAt([torso.x, torso.y, 0]);
  context.beginPath(); // one path, so that nothing is dark twice
  for (const { from, to } of legs) {
    context.moveTo(...camera.toPixels([from[0], from[1], 0]));
    context.lineTo(...camera.toPixels([to[0], to[1], 0]));
  }
  context.stroke();
  const around = Array.from({ length: 24 }, (_, i) => [Math.cos(i / 3.82), Math.sin(i / 3.82)]);
  polygon(context, around.map(([x, y]) =>
    camera.toPixels([torso.x + TORSO_RADIUS * x, torso.y + TORSO_RADIUS * y, 0])));
  context.fill();
}

function drawTorso(context, camera, torso, colors) {
  const at = [torso.x, torso.y, torso.z], [x, y] = camera.toPixels(at);
  const radius = TORSO_RADIUS * camera.scaleAt(at);
  const light = context.createRadialGradient(
    x - radius * 0.35, y - radius * 0.45, radius * 0.1, x, y, radius);
  light.addColorStop(0, "#b9b9cc");
  light.addColorStop(1, colors.torso);
  context.fillStyle = light;
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.fill();
  context.stroke();
}

/** The whole picture. */
function drawAnt(context, camera, player, parts, colors) {
  const [torso] = parts, legs = capsules(player, parts);
  drawFloor(context, camera, colors);
  drawDistances(context, camera, colors);
  drawShadow(context, camera, legs, torso);
  context.lineWidth = Math.max(1, camera.pixels * 0.0035);
  context.strokeStyle = colors.outline;
  const depth = (...points) => points.reduce((sum, p) => sum + camera.seen(p)[2], 0) / points.length;
  const bodies = legs.map(({ leg, k, from, to, radius }) => ({
    depth: depth(from, to),
    draw() {
      const [a, b] = [from, to].map((end) => radius * camera.scaleAt(end));
      outline(context, camera.toPixels(from), a, camera.toPixels(to), b);
      context.fillStyle = colors[["torso", "middle", "bottom"][k]];
      context.fill();
      context.stroke();
      if (k < 2 || !player.contacts[leg]) return;
      context.fillStyle = colors.touch;
      context.beginPath();
      context.arc(...camera.toPixels(to), b, 0, 7);
      context.fill();
    },
  }));
  bodies.push({
    depth: depth([torso.x, torso.y, torso.z]),
    draw: () => drawTorso(context, camera, torso, colors),
  });
  for (const body of bodies.sort((a, b) => b.depth - a.depth)) body.draw();
}

/** Where a leg can be taken: of each part its end, and both sides. */
function antHandles({ player, parts, camera }) {
  const { originals } = player.task;
  return capsules(player, parts).flatMap(({ leg, k, turn, from, to, radius }) => {
    const first = 9 * leg + 2 * k, thick = 9 * leg + 6 + k;
    const [a, b] = [from, to].map((point) => camera.toPixels(point));
    // What a metre along either axis of the part is in the picture, in pixels.
    const axes = [[1, 0, 0], [0, 1, 0]].map((axis) => {
      const [x, y] = camera.toPixels(along(to, 0.01, turnedBy(turn, axis)));
      return [100 * (x - b[0]), 100 * (y - b[1])];
    });
    const end = {
      key: `${first}`, end: true, indices: [first, first + 1], pixels: b,
      pull: (design, dx, dy) => pulled(axes, dx, dy, camera.scaleAt(to)).reduce(
        (found, m, i) => found.with(first + i, limited(design[first + i] + m / originals[first + i])),
        design),
    };
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]) + Math.PI / 2;
    const scale = camera.scaleAt(along(from, 0.5, along(to, -1, from)));
    return [end, ...[1, -1].map((side) => {
      const [x, y] = [side * Math.cos(angle), side * Math.sin(angle)], r = radius * scale;
      return {
        key: `${thick} ${side}`, end: false, indices: [thick],
        pixels: [(a[0] + b[0]) / 2 + x * r, (a[1] + b[1]) / 2 + y * r],
        pull: (design, dx, dy) => design.with(thick,
          limited(design[thick] + (x * dx + y * dy) / scale / originals[thick])),
      };
    })];
  });
}

/**
 * How far along both axes, in m, to follow the pointer by so many pixels: least squares, damped
 * for an axis that points at the eye.
 */
function pulled(axes, dx, dy, scale) {
  const [[ax, ay], [bx, by]] = axes;
  const damping = (0.2 * scale) ** 2;
  const aa = ax * ax + ay * ay + damping, bb = bx * bx + by * by + damping, ab = ax * bx + ay * by;
  const ad = ax * dx + ay * dy, bd = bx * dx + by * dy, determinant = aa * bb - ab * ab;
  return [(ad * bb - bd * ab) / determinant, (bd * aa - ad * ab) / determinant];
}

/** See stage.js. */
export const antLook = {
  makeCamera: () => new AntCamera(), blend: blendAnt, draw: drawAnt, handles: antHandles,
  middle: ({ parts: [{ x, y, z }], camera }) =>
    [...camera.toPixels([x, y, z]), 1.4 * camera.scaleAt([x, y, z])],
  match: () => {}, // all are
  metres: ({ parts: [torso] }) => Math.max(0, torso.x),
};
