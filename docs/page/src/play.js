// window.designrl: the engine for scripts and tests, without a picture.

import { LARGEST, ORIGINAL, SMALLEST, Walker } from "./engine.js";

export function publicInterface(engine, agents) {
  let walker;
  return {
    agents: [...agents.keys()],

    /**
     * Plays an episode as fast as it can, with the bits of `Simulator.rollout`.
     * @param {{agent: string, seed: number|bigint, design?: number[]|null, lidar?: "v2"|"v3"}} what
     *   design: scales of the body; null: the agent's own
     * @returns {Promise<{score: number, steps: number}>}
     */
    async play({ agent: name, seed, design = null, lidar = "v2" }) {
      const agent = agents.get(name);
      if (!agent) throw new Error(`There is no agent ${name}; see designrl.agents.`);
      const body = design ?? agent.design;
      const usable = (scale) => scale >= SMALLEST && scale <= LARGEST;
      if (body.length !== ORIGINAL.length || !Array.from(body).every(usable))
        throw new Error(`A design is ${ORIGINAL.length} scales from ${SMALLEST} to ${LARGEST}.`);
      walker ??= new Walker(engine);
      walker.start(agent.weights, body, { seed, hardcore: agent.hardcore, lidar });
      while (!walker.ended) walker.step();
      if (walker.failed) throw new Error("The walker has more contacts than the engine holds.");
      return { score: walker.score, steps: walker.steps };
    },
  };
}
