// Beside the walker: score, the rewards that it is made of, the torque, and evaluate's score.

import { TERMS } from "./engine.js";
import { drawLine } from "./charts.js";

const CHART_SECONDS = 12;
const EVERY = 5; // steps between points of the score's curve

export class Panel {
  constructor(element) {
    this.at = (name) => element.querySelector(`[data-at="${name}"]`);
    this.at("terms").innerHTML = TERMS.map((term) => `<tr><th>${term}</th>
      <td class="bar"><i data-bar="${term}"></i></td><td data-term="${term}"></td></tr>`).join("");
    this.bars = TERMS.map((term) => element.querySelector(`[data-bar="${term}"]`));
    this.values = TERMS.map((term) => element.querySelector(`[data-term="${term}"]`));
    this.forget();
    this.start();
  }

  forget() {
    this.courses = this.falls = 0;
  }

  start() {
    this.sums = TERMS.map(() => 0);
    this.efforts = [];
    this.spent = 0;
    this.scores = [[0, 0]];
  }

  stepped(walker) {
    walker.terms.forEach((term, i) => (this.sums[i] += term));
    this.spent += walker.effort / 4;
    this.efforts.push(walker.effort / 4);
    if (walker.steps % EVERY === 0) this.scores.push([walker.steps, walker.score]);
  }

  ended(walker) {
    this.courses += 1;
    if (walker.fell) this.falls += 1;
  }

  /** expected: evaluate's score on this course, or why there is none to compare with. */
  draw(walker, limit, expected, colors) {
    const seconds = walker.steps / 50;
    this.at("score").textContent = walker.score.toFixed(1);
    this.at("time").textContent = `${seconds.toFixed(1)} s`;
    this.at("tally").textContent =
      `${this.falls} ${this.falls === 1 ? "fall" : "falls"} in ${this.courses} ` +
      `${this.courses === 1 ? "course" : "courses"}`;
    this.sums.forEach((sum, i) => {
      const share = Math.min(1, Math.abs(sum) / 320);
      const bar = this.bars[i];
      bar.style.width = `${50 * share}%`;
      bar.style.left = sum < 0 ? `${50 - 50 * share}%` : "50%";
      bar.className = sum < 0 ? "less" : "more";
      this.values[i].textContent = Math.abs(sum) < 0.05 ? "0" : sum.toFixed(1).replace("-", "−");
    });
    const mean = walker.steps ? this.spent / walker.steps : 0;
    this.at("torque").textContent = `${Math.round(100 * mean)} % of the motors’ full`;
    const recent = this.efforts.slice(-CHART_SECONDS * 50);
    const smooth = recent.map((_, i) => {
      const few = recent.slice(Math.max(0, i - 9), i + 1);
      return [i, few.reduce((a, b) => a + b, 0) / few.length];
    });
    const color = colors.accent;
    const now = walker.steps % EVERY ? [[walker.steps, walker.score]] : [];
    drawLine(this.at("torque-chart"), smooth, { x: [0, CHART_SECONDS * 50], y: [0, 1], color });
    drawLine(this.at("score-chart"), [...this.scores, ...now],
      { x: [0, limit], y: [-110, 330], color, zero: colors.label });
    this.drawTruth(walker, expected);
  }

  drawTruth(walker, expected) {
    const known = typeof expected === "number";
    const same = known && walker.ended && walker.score === expected;
    const state = !known ? "none" : !walker.ended ? "running" : same ? "same" : "other";
    this.at("truth").dataset.state = state;
    this.at("expected").textContent = known ? String(expected) : expected;
    this.at("here").textContent = walker.ended || known ? String(walker.score) : "";
    this.at("verdict").textContent = {
      none: "", running: "walking …", same: "the same to the last bit", other: "not the same",
    }[state];
  }
}
