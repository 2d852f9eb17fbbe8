// The engine (designrl/engine/native/page.cpp) as WebAssembly: walkers that a policy steps.

export const TERMS = ["progress", "posture", "energy", "fall"];
export const PARTS = ["hull", "top leg 1", "bottom leg 1", "top leg 2", "bottom leg 2"];
export const DIMENSIONS = PARTS.slice(1).flatMap((part) => [`${part} width`, `${part} height`]);
export const ORIGINAL = Object.freeze([1, 1, 1, 1, 1, 1, 1, 1]);
export const ORIGINAL_SIZES = [8, 34, 6.4, 34, 8, 34, 6.4, 34]; // 1/30 m
export const SCALE = 30; // of those units a metre has
export const [SMALLEST, LARGEST] = [0.25, 1.75]; // scales, the paper's limits
export const STEPS_PER_SECOND = 50;
const WEIGHTS = 2804;
const RAYS = 10;
const TIME_LIMIT = { flat: 1600, hardcore: 2000 }; // steps
const HARDCORE = 1, CLOSEST_HITS = 2; // flags

/** @param {Uint8Array<ArrayBuffer>} bytes @returns {Promise<any>} what the engine exports */
export async function startEngine(bytes) {
  const { exports } = new WebAssembly.Instance(await WebAssembly.compile(bytes));
  /** @type {any} */ (exports)._initialize();
  return exports;
}

/** One walker on its course. Positions are in m, with x ahead and y up. */
export class Walker {
  constructor(engine) {
    this.engine = engine;
    this.player = engine.page_make();
    if (!this.player) throw new Error("There is no memory for another walker.");
    this.design = [...ORIGINAL];
  }

  numbers(type, address, count) { // anew each time: memory that has grown has moved
    return new type(this.engine.memory.buffer, address, count);
  }

  /**
   * @param {Float32Array} weights the policy's
   * @param {ArrayLike<number>} design scales of the body
   * @param {{seed: number|bigint, hardcore: boolean, lidar?: "v2"|"v3"}} course
   */
  start(weights, design, { seed, hardcore, lidar = "v2" }) {
    this.numbers(Float32Array, this.engine.page_weights(this.player), WEIGHTS).set(weights);
    this.putDesign(design);
    const flags = (hardcore ? HARDCORE : 0) | (lidar === "v3" ? CLOSEST_HITS : 0);
    const limit = TIME_LIMIT[hardcore ? "hardcore" : "flat"];
    this.engine.page_start(this.player, BigInt(seed), flags, limit);
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
    this.numbers(Float64Array, this.engine.page_design(this.player), 8).set(this.design);
  }

  read() {
    const count = 5 + TERMS.length + 1 + 2 + PARTS.length * 7 + 8 + RAYS * 2;
    const all = this.numbers(Float64Array, this.engine.page_shown(this.player), count);
    let at = 0;
    const next = (n) => all.subarray(at, (at += n));
    const [score, steps, ended, fell, failed] = next(5);
    this.score = score;
    this.steps = steps;
    this.ended = !!ended;
    this.fell = !!fell;
    this.failed = !!failed;
    this.terms = Array.from(next(TERMS.length));
    this.effort = next(1)[0]; // of the motors' full torques, summed
    this.contacts = Array.from(next(2), Boolean);
    this.parts = PARTS.map(() => {
      const [x, , y, , turnY, , turnW] = next(7);
      return { x, y, angle: -2 * Math.atan2(turnY, turnW) };
    });
    this.sizes = PARTS.slice(1).map(() => {
      const [width, height] = next(2);
      return { width, height };
    });
    this.rays = Array.from({ length: RAYS }, () => Array.from(next(2)));
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
