// How it came about: a slider over the generations of a run.

import { drawLine, fixed } from "./charts.js";
import { Clock, Stage } from "./stage.js";

/** The last of some rows whose generation is not after this one. */
function latest(rows, generation) {
  return rows.reduce((found, row) => (row.generation <= generation ? row : found), rows[0]);
}

/** The row of the generation next to this one. */
function nearest(rows, generation) {
  const away = (row) => Math.abs(row.generation - generation);
  return rows.reduce((found, row) => (away(row) <= away(found) ? row : found));
}

function between(bodies, generation) {
  const before = latest(bodies, generation);
  const after = bodies.find((body) => body.generation > generation) ?? before;
  const span = after.generation - before.generation;
  const share = span ? Math.max(0, (generation - before.generation) / span) : 0;
  return before.scales.map((scale, i) => scale + (after.scales[i] - scale) * share);
}

export class History {
  constructor(engine, element, data) {
    this.data = data;
    this.at = (name) => element.querySelector(`[data-at="${name}"]`);
    this.stage = new Stage(engine, this.at("canvas"), { again: () => this.begin() });
    this.clock = new Clock([this.stage], element);
    this.clock.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    const select = this.at("run");
    for (const name of Object.keys(data.runs)) {
      if (!data.runs[name].bodies) continue;
      select.append(new Option(`${data.experiments[data.agents.get(name).experiment]}, ` +
        `${name.split("/")[1].replace("seed", "seed ")}`, name));
    }
    select.value = [...select.options].find((option) => option.value.includes("hardcore"))?.value
      ?? select.value;
    const [experiment, seed] = select.value.split("/");
    if (seed !== "seed0" && data.runs[`${experiment}/seed0`])
      this.at("why").textContent = `It begins with ${seed.replace("seed", "seed ")}: the recording ` +
        "of seed 0 does not have the bodies of its first generations. ";
    select.addEventListener("change", () => this.choose(select.value));
    this.at("generation").addEventListener("input", () => this.show());
    this.at("play").addEventListener("click", () => this.play());
    new ResizeObserver(() => this.drawCurve()).observe(this.at("curve"));
    this.choose(select.value);
  }

  choose(name) {
    this.run = this.data.runs[name];
    this.agent = this.data.agents.get(name);
    const slider = this.at("generation");
    slider.max = String(this.run.generations);
    slider.value = slider.max;
    this.policies = [...(this.run.policies ?? [])];
    this.policies.push({ generation: this.run.kept, policy: this.agent.policy });
    this.policies.sort((a, b) => a.generation - b.generation);
    this.show();
    this.begin();
  }

  get generation() { return Number(this.at("generation").value); }
  /** The generation whose body walks; after the best one, that of the published agent. */
  get bodys() { return Math.min(this.generation, this.run.kept); }
  get design() {
    return this.generation >= this.run.kept ? this.agent.design
      : between(this.run.bodies, this.generation);
  }
  get policy() { return nearest(this.policies, this.generation); }

  begin() {
    this.walking = this.policy;
    const course = { ...this.agent, seed: this.data.courses[0] };
    this.stage.start(this.agent.task, this.walking.policy, this.design, course);
  }

  /** Moves through all generations in eight seconds. */
  play() {
    clearInterval(this.timer);
    const slider = this.at("generation");
    let generation = this.generation >= this.run.generations ? 0 : this.generation;
    this.timer = setInterval(() => {
      generation = Math.min(this.run.generations, generation + this.run.generations / 160);
      slider.value = String(Math.round(generation));
      this.show();
      if (generation >= this.run.generations) clearInterval(this.timer);
    }, 50);
  }

  show() {
    const { generation, policy, run, bodys } = this;
    const number = (value) => value.toLocaleString("en");
    if (policy !== this.walking) this.begin();
    else this.stage.changeBody(this.design);
    const score = latest(run.scores, generation);
    this.at("evaluated").textContent = generation < run.scores[0].generation ? "not evaluated yet"
      : `evaluation of generation ${number(score.generation)}: ` +
        `${fixed(score.mean, 0)} points`;
    const untrained = policy.generation ? "" : ", untrained";
    const recorded = bodys === run.kept ? "the published agent" : "the recorded distribution";
    this.at("walks").innerHTML = policy.generation === bodys
      ? `body and policy of generation <b>${number(bodys)}</b>: ${recorded}${untrained}`
      : `body of generation <b>${number(bodys)}</b>, ` +
        `policy of generation <b>${number(policy.generation)}</b>${untrained}`;
    this.drawCurve();
    this.stage.draw();
  }

  drawCurve() {
    if (!this.run) return;
    const { scores, generations } = this.run, means = scores.map(({ mean }) => mean);
    const { accent, label, soft } = this.stage.colors;
    drawLine(this.at("curve"), scores.map((row) => [row.generation, row.mean]), {
      x: [0, generations], y: [Math.min(0, ...means), Math.max(0, ...means)], color: accent,
      zero: label, mark: this.generation, labels: soft,
    });
  }
}
