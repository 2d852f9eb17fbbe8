// window.designrl: the engine for scripts and tests, without a picture.

import { LARGEST, Player, SMALLEST, TASKS } from "./engine.js";

export function publicInterface(engine, agents) {
  /** @type {Record<string, Player>} */
  const players = {};
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
      const { length } = agent.design;
      if (body.length !== length || !Array.from(body).every(usable))
        throw new Error(`A design is ${length} scales from ${SMALLEST} to ${LARGEST}.`);
      const player = players[agent.task] ??= new Player(engine, TASKS[agent.task]);
      player.start(agent.policy, body, { ...agent, seed, lidar });
      while (!player.ended) player.step();
      if (player.failed) throw new Error("There are more contacts than the engine holds.");
      return { score: player.score, steps: player.steps };
    },
  };
}
