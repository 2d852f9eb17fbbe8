// Beside the picture: score, the rewards that it is made of, the torque, and evaluate's score.

import { drawLine, fixed } from "./charts.js";

const CHART_SECONDS = 12;
const EVERY = 5; // steps between points of the score's curve, and pictures of the charts

export class Panel {
  constructor(element) {
    this.at = (name) => element.querySelector(`[data-at="${name}"]`);
    this.forget();
  }

  /** Shows the rewards of a task. */
  build(task) {
    if (task === this.task) return;
    this.task = task;
    const terms = this.at("terms");
    terms.innerHTML = task.terms.map((term) => `<tr><th>${term}</th>
      <td class="bar"><i data-bar="${term}"></i></td><td data-term="${term}"></td></tr>`).join("");
    this.bars = [...terms.querySelectorAll("[data-bar]")];
    this.values = [...terms.querySelectorAll("[data-term]")];
  }

  forget() {
    this.courses = this.falls = 0;
  }

  start() {
    this.sums = this.task.terms.map(() => 0);
    this.efforts = [];
    this.spent = 0;
    this.scores = [[0, 0]];
  }

  stepped(player) {
    player.terms.forEach((term, i) => (this.sums[i] += term));
    this.spent += player.effort;
    this.efforts.push(player.effort);
    if (player.steps % EVERY === 0) this.scores.push([player.steps, player.score]);
  }

  ended(player) {
    this.courses += 1;
    if (player.fell) this.falls += 1;
  }

  /** expected: evaluate's score on this course, or why there is none to compare with. */
  draw(player, expected, colors) {
    const { stepsPerSecond, scores } = this.task, seconds = player.steps / stepsPerSecond;
    this.at("score").textContent = fixed(player.score, 1);
    this.at("time").textContent = `${seconds.toFixed(1)} s`;
    this.at("tally").textContent =
      `${this.falls} ${this.falls === 1 ? "fall" : "falls"} in ${this.courses} ` +
      `${this.courses === 1 ? "course" : "courses"}`;
    this.sums.forEach((sum, i) => {
      const share = Math.min(1, Math.abs(sum) / scores[1]);
      const bar = this.bars[i];
      bar.style.width = `${50 * share}%`;
      bar.style.left = sum < 0 ? `${50 - 50 * share}%` : "50%";
      bar.className = sum < 0 ? "less" : "more";
      this.values[i].textContent = Math.abs(sum) < 0.05 ? "0" : fixed(sum, 1);
    });
    const mean = player.steps ? this.spent / player.steps : 0;
    this.at("torque").textContent = `${Math.round(100 * mean)} % of the motors’ full`;
    this.drawTruth(player, expected);
    if (player.steps % EVERY && !player.ended) return;
    const recent = this.efforts.slice(-Math.round(CHART_SECONDS * stepsPerSecond));
    const smooth = recent.map((_, i) => {
      const few = recent.slice(Math.max(0, i - 9), i + 1);
      return [i, few.reduce((a, b) => a + b, 0) / few.length];
    });
    const color = colors.accent, last = [player.steps, player.score];
    drawLine(this.at("torque-chart"), smooth, { x: [0, CHART_SECONDS * stepsPerSecond], y: [0, 1], color });
    drawLine(this.at("score-chart"), [...this.scores, last],
      { x: [0, player.limit], y: scores, color, zero: colors.label });
  }

  drawTruth(player, expected) {
    const known = typeof expected === "number";
    const same = known && player.ended && player.score === expected;
    const state = !known ? "none" : !player.ended ? "running" : same ? "same" : "other";
    this.at("truth").dataset.state = state;
    this.at("expected").textContent = known ? String(expected) : expected;
    this.at("here").textContent = player.ended || known ? String(player.score) : "";
    this.at("verdict").textContent = {
      none: "", running: "walking …", same: "the same to the last bit", other: "not the same",
    }[state];
  }
}
