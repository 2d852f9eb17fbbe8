// The walker on its course, drawn as in the recordings, and where one can take hold of it.

import { LARGEST, SCALE, SMALLEST } from "./engine.js";

const HULL = [[-30, 9], [6, 9], [34, 1], [34, -8], [-30, -8]].map(([x, y]) => [x / SCALE, y / SCALE]);
const STEP = 14 / SCALE; // m of a piece of ground
const FINISH = 190 * STEP; // m
const START = 10 * STEP; // m

/** Colors of a theme, from the style sheet. */
export function themeColors() {
  const style = getComputedStyle(document.documentElement);
  const names = ["sky", "sky-low", "ground", "soil", "obstacle", "hull", "leg-1", "leg-2", "ray",
    "outline", "label", "mark", "soft", "touch", "accent", "tile", "floor", "torso", "middle", "bottom"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function turned(angle, x, y) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return [c * x - s * y, s * x + c * y];
}

export const mix = (a, b, share) => a + (b - a) * share;
export const limited = (scale) => Math.min(LARGEST, Math.max(SMALLEST, scale));

/** What is to be drawn between two steps: each part's place in the picture's plane, blended. */
function blendWalker(before, after, share) {
  const angle = ({ turn: [, y, , w] }) => -2 * Math.atan2(y, w);
  return after.map((part, i) => ({
    x: mix(before[i].x, part.x, share), y: mix(before[i].z, part.z, share),
    angle: mix(angle(before[i]), angle(part), share),
  }));
}

/** m, of the legs' parts. */
function sizesOf({ design, task: { originals } }) {
  const size = (i) => (originals[i] * design[i]) / SCALE;
  return [0, 2, 4, 6].map((i) => ({ width: size(i), height: size(i + 1) }));
}

/** m. */
function longestLeg(player) {
  const sizes = sizesOf(player);
  return Math.max(...[0, 2].map((i) => sizes[i].height + sizes[i + 1].height));
}

/** Where the picture looks; follows the walker. */
class Camera {
  constructor() {
    this.ready = false;
    this.longest = 0; // m, of a leg that is to fit, too, beside the walker's own
    this.x = this.ground = this.pixels = 0; // m, m, pixels a m
    this.left = this.bottom = this.width = this.height = 0;
  }

  /** width, height: of the picture, in pixels. */
  follow(player, hull, width, height) {
    const leg = longestLeg(player);
    const near = player.ground.filter(([x]) => Math.abs(x - hull.x) < 4).map(([, y]) => y);
    const ground = near.length ? near.reduce((a, b) => a + b, 0) / near.length : hull.y - leg;
    const pixels = Math.min((0.62 * height) / (Math.max(leg, this.longest, 1.6) + 0.6), width / 5.2);
    const target = { pixels, x: hull.x, ground };
    if (!this.ready) Object.assign(this, target);
    this.ready = true;
    this.x = hull.x;
    this.ground += (ground - this.ground) * 0.06;
    this.pixels += (pixels - this.pixels) * 0.08;
    this.left = this.x - (width * 0.36) / this.pixels;
    this.bottom = this.ground - (height * 0.2) / this.pixels;
    this.height = height;
    this.width = width;
  }

  toPixels([x, y]) {
    return [(x - this.left) * this.pixels, this.height - (y - this.bottom) * this.pixels];
  }

  toWorld([px, py]) {
    return [px / this.pixels + this.left, (this.height - py) / this.pixels + this.bottom];
  }
}

export function polygon(context, points) {
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.closePath();
}

function drawGround(context, camera, player, colors) {
  const { width, height } = camera;
  const margin = 2;
  const left = camera.left - margin, right = camera.left + width / camera.pixels + margin;
  const seen = player.ground.filter(([x]) => x > left && x < right).map((p) => camera.toPixels(p));
  if (seen.length > 1) {
    const first = player.ground[0][0] > left ? [-9, seen[0][1]] : seen[0];
    polygon(context, [[first[0], height + 9], first, ...seen, [seen[seen.length - 1][0], height + 9]]);
    const shade = context.createLinearGradient(0, height * 0.7, 0, height);
    shade.addColorStop(0, colors.ground);
    shade.addColorStop(1, colors.soil);
    context.fillStyle = shade;
    context.fill();
  }
  context.fillStyle = colors.obstacle;
  context.strokeStyle = colors.outline;
  context.lineWidth = 1;
  for (const corners of player.obstacles) {
    const xs = corners.map(([x]) => x);
    if (Math.max(...xs) < left || Math.min(...xs) > right) continue;
    polygon(context, corners.map((p) => camera.toPixels(p)));
    context.fill();
    context.stroke();
  }
}

function drawMarks(context, camera, player, colors) {
  const right = camera.left + camera.width / camera.pixels;
  context.fillStyle = colors.mark;
  context.strokeStyle = colors.ground; // around the letters
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.font = "600 13px system-ui, sans-serif";
  context.textAlign = "center";
  for (let x = 10 * Math.ceil(camera.left / 10); x < right; x += 10) {
    if (x < START || x > FINISH) continue;
    const [px] = camera.toPixels([x, 0]);
    context.fillRect(px - 1, camera.height - 25, 2, 7);
    context.strokeText(`${x} m`, px, camera.height - 6);
    context.fillText(`${x} m`, px, camera.height - 6);
  }
  for (const x of [START, FINISH]) {
    if (x < camera.left - 1 || x > right + 1) continue;
    const at = player.ground.find(([gx]) => gx >= x - 1e-3) ?? player.ground.at(-1);
    const [px, py] = camera.toPixels(at);
    const tall = 1.7 * camera.pixels;
    context.strokeStyle = colors.outline;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(px, py);
    context.lineTo(px, py - tall);
    context.stroke();
    polygon(context, [[px, py - tall], [px + 26, py - tall + 8], [px, py - tall + 17]]);
    context.fillStyle = x === FINISH ? colors.accent : colors.touch;
    context.fill();
  }
}

/** Corners of a part of a leg, in m. */
function partCorners(part, { width, height }) {
  const w = width / 2;
  return [[-w, 0], [w, 0], [w, -height], [-w, -height]].map(([x, y]) => {
    const [dx, dy] = turned(part.angle, x, y);
    return [part.x + dx, part.y + dy];
  });
}

function drawBody(context, camera, player, parts, colors) {
  const sizes = sizesOf(player);
  context.lineJoin = "round";
  context.lineWidth = Math.max(1, camera.pixels * 0.02);
  context.strokeStyle = colors.outline;
  const draw = (corners, fill) => {
    polygon(context, corners.map((p) => camera.toPixels(p)));
    context.fillStyle = fill;
    context.fill();
    context.stroke();
  };
  for (const leg of [0, 1])
    for (const i of [2 * leg, 2 * leg + 1]) {
      draw(partCorners(parts[i + 1], sizes[i]), leg ? colors["leg-2"] : colors["leg-1"]);
      if (i % 2 && player.contacts[leg]) {
        const [, , a, b] = partCorners(parts[i + 1], sizes[i]).map((p) => camera.toPixels(p));
        context.save();
        context.strokeStyle = colors.touch;
        context.lineWidth = Math.max(3, camera.pixels * 0.05);
        context.lineCap = "round";
        context.beginPath();
        context.moveTo(a[0], a[1]);
        context.lineTo(b[0], b[1]);
        context.stroke();
        context.restore();
      }
    }
  const hull = parts[0];
  draw(HULL.map(([x, y]) => {
    const [dx, dy] = turned(hull.angle, x, y);
    return [hull.x + dx, hull.y + dy];
  }), colors.hull);
}

function drawRays(context, camera, player, hull, colors) {
  context.strokeStyle = context.fillStyle = colors.ray;
  context.lineWidth = 1;
  const from = camera.toPixels([hull.x, hull.y]);
  const [dx, dy] = [hull.x - player.parts[0].x, hull.y - player.parts[0].z];
  for (const [x, y] of player.rays) {
    const to = camera.toPixels([x + dx, y + dy]);
    context.globalAlpha = 0.45;
    context.beginPath();
    context.moveTo(from[0], from[1]);
    context.lineTo(to[0], to[1]);
    context.stroke();
    context.globalAlpha = 0.9;
    context.beginPath();
    context.arc(to[0], to[1], 2, 0, 7);
    context.fill();
  }
  context.globalAlpha = 1;
}

/** The whole picture. */
function drawWalker(context, camera, player, parts, colors) {
  const sky = context.createLinearGradient(0, 0, 0, camera.height);
  sky.addColorStop(0, colors.sky);
  sky.addColorStop(1, colors["sky-low"]);
  context.fillStyle = sky;
  context.fillRect(0, 0, camera.width, camera.height);
  drawGround(context, camera, player, colors);
  drawMarks(context, camera, player, colors);
  drawRays(context, camera, player, parts[0], colors);
  drawBody(context, camera, player, parts, colors);
}

/** Where a leg can be taken: of each part its end, and both edges. */
function walkerHandles({ player, parts, camera }) {
  return sizesOf(player).flatMap((size, i) => {
    const { angle } = parts[i + 1];
    const [a, b, c, d] = partCorners(parts[i + 1], size);
    const handle = (side, [p, q]) => {
      const index = 2 * i + (side ? 0 : 1);
      const [ux, uy] = side ? turned(angle, side, 0) : turned(angle, 0, -1);
      const per = (SCALE * (side ? 2 : 1)) / player.task.originals[index]; // an edge moves both
      const pull = (design, dx, dy) => design.with(index,
        limited(design[index] + ((ux * dx - uy * dy) / camera.pixels) * per));
      const at = camera.toPixels([(p[0] + q[0]) / 2, (p[1] + q[1]) / 2]);
      return { key: `${index} ${side}`, end: !side, indices: [index], pixels: at, pull };
    };
    return [handle(0, [c, d]), handle(1, [b, c]), handle(-1, [a, d])];
  });
}

/** See stage.js. */
export const walkerLook = {
  makeCamera: () => new Camera(), blend: blendWalker, draw: drawWalker, handles: walkerHandles,
  middle: ({ parts, camera }) => [...camera.toPixels([parts[0].x, parts[0].y]), camera.pixels * 2.2],
  match: (players, cameras) => { // in the same scale
    const longest = Math.max(...players.map(longestLeg));
    for (const camera of cameras) Object.assign(camera, { longest, ready: false });
  },
  metres: ({ parts: [hull] }) => Math.max(0, hull.x - START),
};
