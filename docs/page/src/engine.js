// The engine (designrl/engine/native/page.cpp) as WebAssembly: walkers and ants that a policy steps.

export const [SMALLEST, LARGEST] = [0.25, 1.75]; // scales, the paper's limits
export const SCALE = 30; // of the walker's units a metre has
const RAYS = 10;
const HARDCORE = 1, CLOSEST_HITS = 2; // flags
const WALKER_PARTS = ["top leg 1", "bottom leg 1", "top leg 2", "bottom leg 2"];
export const ANT_LEGS = ["front left", "front right", "back left", "back right"];
export const ANT_PARTS = ["top", "middle", "bottom"];

/**
 * @typedef {object} Task
 * @property {string} name
 * @property {number} weights how many a policy has
 * @property {string[]} dimensions of the body, in the order of a design
 * @property {number[]} originals their sizes: 1/30 m, and m
 * @property {string[]} terms of the rewards
 * @property {number} parts of the body
 * @property {number} contacts how many parts may touch the ground
 * @property {number} joints
 * @property {number} stepsPerSecond
 * @property {number[]} scores their range, for charts
 */
/** @type {Record<string, Task>} */
export const TASKS = {
  walker: {
    name: "walker", weights: 2804,
    dimensions: WALKER_PARTS.flatMap((part) => [`${part} width`, `${part} height`]),
    originals: [8, 34, 6.4, 34, 8, 34, 6.4, 34],
    terms: ["progress", "posture", "energy", "fall"],
    parts: 5, contacts: 2, joints: 4, stepsPerSecond: 50, scores: [-120, 350],
  },
  ant: {
    name: "ant", weights: 4264,
    dimensions: ANT_LEGS.flatMap((leg) => [
      ...ANT_PARTS.flatMap((part) => [`${leg} ${part} ahead`, `${leg} ${part} aside`]),
      ...ANT_PARTS.map((part) => `${leg} ${part} radius`),
    ]),
    originals: [[1, 1], [-1, 1], [-1, -1], [1, -1]].flatMap(([x, y]) =>
      [0.2, 0.2, 0.4].flatMap((length) => [x * length, y * length]).concat([0.08, 0.08, 0.08])),
    terms: ["alive", "progress", "electricity", "stall", "joint limits", "feet"],
    parts: 13, contacts: 4, joints: 8, stepsPerSecond: 1 / 0.0165, scores: [-500, 7000],
  },
};
export const originalOf = (task) => task.dimensions.map(() => 1);

/** @param {Uint8Array<ArrayBuffer>} bytes @returns {Promise<any>} what the engine exports */
export async function startEngine(bytes) {
  const { exports } = new WebAssembly.Instance(await WebAssembly.compile(bytes));
  /** @type {any} */ (exports)._initialize();
  return exports;
}

/** One walker or ant on its course. In m and rad, with x ahead, y to the left and z up. */
export class Player {
  /** @param {any} engine @param {Task} task */
  constructor(engine, task) {
    this.engine = engine;
    this.task = task;
    this.player = engine[`page_make_${task.name}`]();
    if (!this.player) throw new Error(`There is no memory for another ${task.name}.`);
    this.design = originalOf(task);
  }

  numbers(type, address, count) { // anew each time: memory that has grown has moved
    return new type(this.engine.memory.buffer, address, count);
  }

  /**
   * @param {{weights: Float32Array, stds?: number[]}} policy stds: of its noise, if it has any
   * @param {ArrayLike<number>} design scales of the body
   * @param {{seed: number|bigint, hardcore: boolean, limit: number, lidar?: "v2"|"v3"}} course
   *   limit: steps
   */
  start(policy, design, { seed, hardcore, limit, lidar = "v2" }) {
    const { task, engine, player } = this;
    this.numbers(Float32Array, engine.page_weights(player), task.weights).set(policy.weights);
    if (policy.stds) this.numbers(Float64Array, engine.page_stds(player), task.joints).set(policy.stds);
    this.putDesign(design);
    const flags = (hardcore ? HARDCORE : 0) | (lidar === "v3" ? CLOSEST_HITS : 0);
    engine.page_start(player, BigInt(seed), flags, limit);
    this.limit = limit;
    this.readTerrain();
    this.read();
  }

  step() {
    this.engine.page_step(this.player);
    this.read();
  }

  /** Goes on in another body, standing where it is. */
  changeBody(design) {
    this.putDesign(design);
    this.engine.page_change_body(this.player);
    this.read();
  }

  putDesign(design) {
    this.design = Array.from(design);
    const address = this.engine.page_design(this.player);
    this.numbers(Float64Array, address, this.design.length).set(this.design);
  }

  read() {
    const { task } = this, rays = task.name === "walker" ? RAYS : 0;
    const count = 6 + task.terms.length + task.parts * 7 + task.contacts + rays * 2;
    const all = this.numbers(Float64Array, this.engine.page_shown(this.player), count);
    let at = 0;
    const next = (n) => all.subarray(at, (at += n));
    const [score, steps, ended, fell, failed, effort] = next(6);
    this.score = score;
    this.steps = steps;
    this.ended = !!ended;
    this.fell = !!fell;
    this.failed = !!failed;
    this.effort = effort / task.joints; // of the motors' full torques
    this.terms = Array.from(next(task.terms.length));
    this.parts = Array.from({ length: task.parts }, () => {
      const [x, y, z, ...turn] = next(7);
      return { x, y, z, turn }; // a quaternion x, y, z, w
    });
    this.contacts = Array.from(next(task.contacts), Boolean);
    this.rays = Array.from({ length: rays }, () => Array.from(next(2)));
  }

  readTerrain() {
    const count = this.engine.page_terrain_count(this.player);
    const rows = this.numbers(Float32Array, this.engine.page_terrain(this.player), count * 9);
    this.ground = []; // points of the profile
    this.obstacles = []; // corners of each
    for (let i = 0; i < count; i++) {
      const [corners, ...xy] = rows.subarray(9 * i, 9 * i + 9);
      const points = Array.from({ length: corners }, (_, k) => [xy[2 * k], xy[2 * k + 1]]);
      if (corners > 2) this.obstacles.push(points);
      else this.ground.push(...(this.ground.length ? points.slice(1) : points));
    }
  }
}
