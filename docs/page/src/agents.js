// The published agents, as the build (reproduce/page.py) has put them into the page.

import { TASKS } from "./engine.js";

const bytesOf = (base64) => Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
const textOf = (id) => document.getElementById(id)?.textContent ?? "";

export const engineBytes = () => bytesOf(textOf("engine"));

/**
 * @typedef {object} Agent
 * @property {string} name "biped-morphology/seed0"
 * @property {string} experiment
 * @property {"walker"|"ant"} task
 * @property {boolean} hardcore
 * @property {number} limit steps of an episode
 * @property {number[]} design scales of its body
 * @property {{weights: Float32Array, stds?: number[]}} policy stds: of its noise, if it has any
 * @property {number[]} scores `designrl.evaluate`'s, one for each of `courses`
 */

/** Agents by name, seeds of the evaluation's courses, experiments, runs by the agent's name. */
export function readData() {
  const data = JSON.parse(textOf("data"));
  const floats = new Float32Array(bytesOf(textOf("weights")).buffer);
  const policyAt = ({ task, at, stds }) => {
    const { weights: count } = TASKS[task];
    return { stds, weights: at === null ? new Float32Array(count) : floats.subarray(at, at + count) };
  };
  /** @type {Map<string, Agent>} */
  const agents = new Map();
  for (const agent of data.agents) agents.set(agent.name, { ...agent, policy: policyAt(agent) });
  for (const [name, run] of Object.entries(data.runs))
    for (const row of run.policies ?? [])
      row.policy = policyAt({ ...row, task: agents.get(name).task });
  return { agents, courses: data.courses, experiments: data.experiments, runs: data.runs };
}
