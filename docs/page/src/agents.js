// The published agents, as the build (reproduce/page.py) has put them into the page.

const bytesOf = (base64) => Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
const textOf = (id) => document.getElementById(id)?.textContent ?? "";

export const engineBytes = () => bytesOf(textOf("engine"));

/**
 * @typedef {object} Agent
 * @property {string} name "biped-morphology/seed0"
 * @property {string} experiment
 * @property {number[]} design scales of its body
 * @property {Float32Array} weights
 * @property {number[]} scores `designrl.evaluate`'s, one for each of `courses`
 * @property {boolean} hardcore
 */

/** Agents by name, seeds of the evaluation's courses, experiments, runs by the agent's name. */
export function readData() {
  const data = JSON.parse(textOf("data"));
  const floats = new Float32Array(bytesOf(textOf("weights")).buffer);
  const weightsAt = (row) => floats.subarray(row * data.weights, (row + 1) * data.weights);
  /** @type {Map<string, Agent>} */
  const agents = new Map();
  data.agents.forEach((agent, row) => {
    const hardcore = agent.experiment.includes("hardcore");
    agents.set(agent.name, { ...agent, hardcore, weights: weightsAt(row) });
  });
  for (const run of Object.values(data.runs))
    for (const policy of run.policies ?? [])
      policy.weights = policy.row === null ? new Float32Array(data.weights) : weightsAt(policy.row);
  return { agents, courses: data.courses, experiments: data.experiments, runs: data.runs };
}
