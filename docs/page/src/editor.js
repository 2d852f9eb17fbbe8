// The body under one's hands: a leg's end or edge in the picture, and the sliders beside it.

import { ANT_LEGS, LARGEST, SMALLEST } from "./engine.js";
import { limited } from "./scene.js";

const REACH = { mouse: 24, pen: 30, touch: 46 }; // pixels from a handle
const percent = (scale) => `${Math.round(100 * scale)} %`;

/**
 * Dragging in the picture. Time stands still while one drags, and slows down near the body.
 *
 * change(design): called with the scales of the new body.
 */
export class Dragging {
  constructor(stage, change) {
    this.stage = stage;
    this.change = change;
    this.near = this.held = null; // a handle
    this.slow = 1;
    const { canvas } = stage;
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointerleave", () => this.leave());
    for (const kind of ["pointerup", "pointercancel"])
      canvas.addEventListener(kind, () => this.release());
    // A finger that takes hold of a leg must not scroll the page.
    canvas.addEventListener("touchstart", (event) => {
      if (this.held) event.preventDefault();
    }, { passive: false });
  }

  find({ offsetX, offsetY, pointerType }) {
    const away = ({ pixels: [x, y] }) => Math.hypot(x - offsetX, y - offsetY);
    const nearest = this.stage.look.handles(this.stage).sort((a, b) => away(a) - away(b))[0];
    const [x, y, reach] = this.stage.look.middle(this.stage);
    this.slow = pointerType === "mouse" && Math.hypot(x - offsetX, y - offsetY) < reach ? 0.2 : 1;
    return away(nearest) < (REACH[pointerType] ?? REACH.touch) ? nearest : null;
  }

  press(event) {
    if (this.stage.player.ended) return;
    const handle = this.find(event);
    if (!handle) return;
    this.stage.canvas.setPointerCapture(event.pointerId);
    const from = [event.offsetX, event.offsetY], { design } = this.stage.player;
    this.held = { ...handle, from, design };
    this.stage.canvas.classList.add("holding");
  }

  move(event) {
    if (!this.held) {
      this.near = this.find(event);
      this.stage.canvas.classList.toggle("near", !!this.near);
      return;
    }
    const { from, design, pull } = this.held;
    this.change(pull(design, event.offsetX - from[0], event.offsetY - from[1]));
  }

  release() {
    this.held = null;
    this.stage.canvas.classList.remove("holding");
  }

  leave() {
    if (this.held) return;
    this.near = null;
    this.slow = 1;
  }

  /** Of the clock: 0 while one drags. */
  pace() { return this.held ? 0 : this.slow; }

  draw(context) {
    const { camera, colors, look, player } = this.stage;
    if (player.ended) return;
    const handles = look.handles(this.stage), shown = this.held ?? this.near;
    const same = (handle) => handle.key === shown?.key;
    for (const handle of handles) {
      if (!handle.end && !same(handle) && this.slow === 1 && !this.held) continue;
      const [x, y] = handle.pixels;
      context.beginPath();
      context.arc(x, y, same(handle) ? 8 : handle.end ? 5 : 3, 0, 7);
      context.fillStyle = same(handle) ? colors.accent : "#fff";
      context.strokeStyle = colors.outline;
      context.lineWidth = 1.5;
      context.fill();
      context.stroke();
    }
    const found = handles.find(same);
    if (!found) return;
    const { indices, pixels } = found, { dimensions } = player.task;
    const name = (i) => (i === indices[0] ? dimensions[i] : dimensions[i].split(" ").at(-1));
    const text = indices.map((i) => `${name(i)} ${percent(player.design[i])}`).join(", ");
    context.font = "600 13px system-ui, sans-serif";
    context.textAlign = "left";
    const width = context.measureText(text).width;
    const left = Math.min(pixels[0] + 16, camera.width - width - 14);
    context.fillStyle = "rgba(20, 20, 30, 0.82)";
    context.beginPath();
    context.roundRect(left, pixels[1] - 13, width + 14, 24, 6);
    context.fill();
    context.fillStyle = "#fff";
    context.fillText(text, left + 7, pixels[1] + 4);
  }
}

/** A task's dimensions by part: [part, [{index, name}, ...]]. */
function partsOf({ dimensions }) {
  /** @type {Record<string, {index: number, name: string}[]>} */
  const parts = {};
  dimensions.forEach((dimension, index) => {
    const words = dimension.split(" "), name = words.pop();
    (parts[words.join(" ")] ??= []).push({ index, name });
  });
  return Object.entries(parts);
}

/** A slider for each dimension, by part; of the ant's, those of one leg. change(design) as above. */
export class Sliders {
  constructor(element, legs, change) {
    this.element = element;
    this.legs = legs;
    this.change = change;
    for (const leg of ANT_LEGS) {
      const button = document.createElement("button");
      button.textContent = leg;
      button.addEventListener("click", () => this.chooseLeg(leg));
      legs.append(button);
    }
  }

  /** Sliders for this task. */
  build(task) {
    if (task === this.task) return;
    this.task = task;
    this.legs.hidden = task.name !== "ant";
    this.inputs = [];
    this.element.replaceChildren(...partsOf(task).map(([part, dimensions], i) => {
      const group = document.createElement("fieldset");
      const look = task.name === "ant" ? part.split(" ").at(-1) : `leg-${i < 2 ? 1 : 2}`;
      group.innerHTML = `<legend><i class="${look}"></i>${part}</legend>`;
      for (const { index, name } of dimensions) {
        const row = this.makeRow(`${part} ${name}`, name);
        this.inputs[index] = row.querySelector("input");
        this.inputs[index].dataset.index = String(index);
        group.append(row);
      }
      return group;
    }));
    if (!this.legs.hidden) this.chooseLeg(ANT_LEGS[0]);
  }

  makeRow(dimension, name) {
    const row = document.createElement("label");
    row.className = "slider";
    row.innerHTML = `<span>${name}</span><span class="track">
      <input type="range" min="${SMALLEST}" max="${LARGEST}" step="any" aria-label="${dimension}">
      <i class="learned" title="learned"></i></span><output></output>`;
    const input = /** @type {HTMLInputElement} */ (row.querySelector("input"));
    input.addEventListener("input", () => this.change(this.inputs.map(({ value }) => Number(value))));
    input.addEventListener("keydown", (event) => { // without steps, arrows need one
      const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!by) return;
      event.preventDefault();
      input.value = String(limited(Number(input.value) + 0.05 * by));
      input.dispatchEvent(new Event("input"));
    });
    return row;
  }

  chooseLeg(leg) {
    const groups = /** @type {NodeListOf<HTMLElement>} */ (this.element.querySelectorAll("fieldset"));
    for (const group of groups) group.hidden = !group.textContent.startsWith(leg);
    for (const button of this.legs.children)
      button.setAttribute("aria-pressed", String(button.textContent === leg));
  }

  show(design, learned) {
    const changed = new Set();
    design.forEach((scale, i) => {
      const input = this.inputs[i], row = input.closest("label");
      if (Math.abs(Number(input.value) - scale) > 1e-9) changed.add(Math.floor(i / 9));
      input.value = String(scale);
      input.setAttribute("aria-valuetext", `${percent(scale)} of the original`);
      row.querySelector("output").textContent = percent(scale);
      const share = (learned[i] - SMALLEST) / (LARGEST - SMALLEST);
      const mark = /** @type {HTMLElement} */ (row.querySelector(".learned"));
      mark.style.left = `calc(9px + ${share} * (100% - 18px))`; // the thumb's
    });
    const [leg] = changed; // one that is dragged in the picture
    if (changed.size === 1 && !this.legs.hidden) this.chooseLeg(ANT_LEGS[leg]);
  }
}
