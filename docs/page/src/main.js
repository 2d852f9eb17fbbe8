// The page: a walker or an ant to play with, two bodies side by side, and how a body came about.

import { engineBytes, readData } from "./agents.js";
import { fixed } from "./charts.js";
import { Dragging, Sliders } from "./editor.js";
import { TASKS, originalOf, startEngine } from "./engine.js";
import { History } from "./history.js";
import { Panel } from "./panel.js";
import { publicInterface } from "./play.js";
import { Clock, Stage } from "./stage.js";

const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
const label = ({ name }, title) => `${title}, ${name.split("/")[1].replace("seed", "seed ")}`;
const same = (a, b) => a.every((value, i) => value === b[i]);

/** The one at the top: everything that one can do with it. */
class Playground {
  constructor(engine, element, data) {
    this.data = data;
    this.course = 0; // of the evaluation, from 0, as designrl evaluate counts its episodes
    this.at = (name) => element.querySelector(`[data-at="${name}"]`);
    this.panel = new Panel(element);
    this.stage = new Stage(engine, this.at("canvas"), {
      stepped: ({ player }) => this.panel.stepped(player),
      ended: ({ player }) => this.ended(player),
      again: () => this.go(1),
      drawn: (_, context) => this.drawn(context),
    });
    const change = (design) => this.changeBody(design);
    this.sliders = new Sliders(this.at("sliders"), this.at("legs"), change);
    this.dragging = new Dragging(this.stage, change);
    this.clock = new Clock([this.stage], element);
    this.clock.slow = () => this.dragging.pace();
    this.setPlaying(!still);
    this.listen();
    this.fillAgents();
    this.chooseAgent(this.at("agent").value);
  }

  fillAgents() {
    const select = this.at("agent");
    for (const [experiment, title] of Object.entries(this.data.experiments)) {
      const group = document.createElement("optgroup");
      group.label = title;
      for (const agent of this.data.agents.values())
        if (agent.experiment === experiment)
          group.append(new Option(label(agent, title), agent.name));
      if (group.children.length) select.append(group);
    }
    const best = [...this.data.agents.values()]
      .filter(({ experiment }) => experiment === "biped-hardcore-morphology")
      .sort((a, b) => b.mean - a.mean)[0];
    if (best) select.value = best.name;
  }

  listen() {
    const on = (name, kind, action) => this.at(name).addEventListener(kind, action);
    on("agent", "change", () => this.chooseAgent(this.at("agent").value));
    on("play", "click", () => this.setPlaying(!this.clock.playing));
    on("again", "click", () => this.go(0));
    on("next", "click", () => this.go(1));
    on("worst", "click", () => {
      const { scores } = this.agent;
      this.goTo(scores.indexOf(Math.min(...scores)));
    });
    on("speed", "change", () => (this.clock.speed = Number(this.at("speed").value)));
    on("lidar", "change", () => this.go(0));
    on("course", "change", () => {
      const typed = this.at("course").value.trim();
      if (/^\d+$/.test(typed) && Number(typed) < this.data.courses.length) this.goTo(Number(typed));
      else this.showPlace();
    });
    on("seed", "change", () => {
      const typed = this.at("seed").value.trim();
      if (!/^\d{1,18}$/.test(typed)) return this.showPlace();
      const known = this.data.courses.indexOf(Number(typed));
      if (known >= 0) this.goTo(known);
      else this.begin(BigInt(typed));
    });
    on("original", "click", () => this.changeBody(originalOf(TASKS[this.agent.task])));
    on("learned", "click", () => this.changeBody([...this.agent.design]));
    this.stage.canvas.addEventListener("keydown", (event) => {
      const action = {
        " ": () => this.setPlaying(!this.clock.playing), r: () => this.go(0), n: () => this.go(1),
      }[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    });
  }

  setPlaying(playing) {
    this.clock.playing = playing;
    this.at("play").textContent = playing ? "Pause" : "Walk";
  }

  chooseAgent(name) {
    this.agent = this.data.agents.get(name);
    this.at("agent").value = name;
    this.design = [...this.agent.design];
    this.at("mean").textContent = this.agent.mean.toFixed(1);
    this.at("count").textContent = String(this.data.courses.length);
    const task = TASKS[this.agent.task];
    this.panel.build(task);
    this.panel.forget();
    this.sliders.build(task);
    this.at("lidar").disabled = this.agent.task !== "walker";
    this.go(0);
  }

  go(by) {
    this.goTo((this.course + by) % this.data.courses.length);
  }

  goTo(course) {
    this.course = course;
    this.begin(this.data.courses[course]);
  }

  begin(seed) {
    this.seed = seed;
    this.touched = false; // the body, within the course
    this.showPlace();
    this.at("end").textContent = "";
    this.at("frame").dataset.end = "";
    this.panel.start();
    const course = { ...this.agent, seed, lidar: this.at("lidar").value };
    this.stage.start(this.agent.task, this.agent.policy, this.design, course);
    this.sliders.show(this.design, this.agent.design);
  }

  showPlace() {
    this.at("course").value = String(this.course);
    this.at("seed").value = String(this.seed);
  }

  changeBody(design) {
    this.design = design;
    this.at("hint").classList.add("done");
    this.sliders.show(design, this.agent.design);
    if (this.stage.player.steps === 0) return this.begin(this.seed); // nothing is lost by it
    this.touched = true;
    this.stage.changeBody(design);
  }

  ended(player) {
    this.panel.ended(player);
    const end = player.failed ? "more contacts than the engine holds"
      : player.fell ? (this.agent.task === "walker" ? "it fell: −100" : "it fell")
      : player.steps < player.limit ? "it reached the end" : "time is up";
    this.at("end").textContent = end;
    this.at("frame").dataset.end = player.fell ? "fell" : "done";
  }

  /** evaluate's score on this course, or why it has none. */
  expected() {
    if (this.touched) return "none: the body changed on the way";
    if (!same(this.design, this.agent.design)) return "none of this body";
    if (this.agent.task === "walker" && this.at("lidar").value !== "v2") return "none with v3 LIDAR";
    if (this.seed !== this.data.courses[this.course]) return "none of this seed";
    return this.agent.scores[this.course];
  }

  drawn(context) {
    this.dragging.draw(context);
    this.panel.draw(this.stage.player, this.expected(), this.stage.colors);
  }
}

/** Two agents on the same course. */
class SideBySide {
  constructor(engine, element, data) {
    this.data = data;
    this.course = 0;
    this.at = (name) => element.querySelector(`[data-at="${name}"]`);
    this.stages = [0, 1].map((i) => new Stage(engine, this.at(`canvas-${i}`), {
      again: () => this.stages.every(({ player }) => player.ended) && this.go(1),
      drawn: (stage) => this.drawn(i, stage),
    }));
    this.clock = new Clock(this.stages, element);
    this.clock.playing = !still;
    this.at("ground").addEventListener("change", () => this.go(0));
    this.at("next").addEventListener("click", () => this.go(1));
    this.go(0);
  }

  go(by) {
    this.course = (this.course + by) % this.data.courses.length;
    const ground = this.at("ground").value;
    ["", "-morphology"].forEach((body, i) => {
      const all = [...this.data.agents.values()];
      const agent = all.filter(({ experiment }) => experiment === `${ground}${body}`)
        .sort((a, b) => b.mean - a.mean)[0];
      const course = { ...agent, seed: this.data.courses[this.course] };
      const { courses, experiments } = this.data;
      this.at(`name-${i}`).textContent = label(agent, experiments[agent.experiment]);
      this.at(`mean-${i}`).textContent =
        `mean over ${courses.length} courses: ${agent.mean.toFixed(1)}`;
      this.stages[i].start(agent.task, agent.policy, agent.design, course);
    });
    const each = (what) => this.stages.map((stage) => stage[what]);
    this.stages[0].look.match(each("player"), each("camera"));
    for (const stage of this.stages) stage.draw();
    this.at("course").textContent = String(this.course);
  }

  drawn(i, { player, look }) {
    const end = !player.ended ? "" : player.fell ? ", fell" : ", at the end";
    const points = fixed(player.score, 0);
    const seconds = player.steps / player.task.stepsPerSecond;
    this.at(`score-${i}`).textContent =
      `${points} points, ${look.metres(player).toFixed(1)} m in ${seconds.toFixed(1)} s${end}`;
  }
}

async function open() {
  const data = readData();
  const engine = await startEngine(engineBytes());
  /** @type {any} */ (window).designrl = publicInterface(engine, data.agents);
  const figure = (id) => document.getElementById(id);
  const playground = new Playground(engine, figure("playground"), data);
  new SideBySide(engine, figure("side-by-side"), data);
  new History(engine, figure("history"), data);
  const buttons = /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-watch]"));
  for (const button of buttons)
    button.addEventListener("click", () => {
      playground.chooseAgent(button.dataset.watch);
      figure("playground").scrollIntoView({ behavior: "smooth" });
    });
}

open().catch((error) => {
  document.getElementById("failure").textContent = `The walker cannot walk here: ${error.message}`;
});
