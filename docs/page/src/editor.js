// The body under one's hands: a leg's end or edge in the picture, and eight sliders beside it.

import { DIMENSIONS, LARGEST, ORIGINAL_SIZES, PARTS, SCALE, SMALLEST } from "./engine.js";
import { partCorners, turned } from "./scene.js";

const REACH = { mouse: 24, pen: 30, touch: 46 }; // pixels from a handle
const limited = (scale) => Math.min(LARGEST, Math.max(SMALLEST, scale));

/** Handles of a picture's walker: of part i its end, and both edges. */
function handles(stage) {
  return stage.walker.sizes.flatMap((size, i) => {
    const [a, b, c, d] = partCorners(stage.parts[i + 1], size);
    const middle = (p, q) => [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2];
    return [
      { part: i, side: 0, at: middle(c, d) },
      { part: i, side: 1, at: middle(b, c) },
      { part: i, side: -1, at: middle(a, d) },
    ].map((handle) => ({ ...handle, pixels: stage.camera.toPixels(handle.at) }));
  });
}

/**
 * Dragging in the picture. Time stands still while one drags, and slows down near the walker.
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
    const nearest = handles(this.stage).sort((a, b) => away(a) - away(b))[0];
    const [x, y] = this.stage.camera.toPixels([this.stage.parts[0].x, this.stage.parts[0].y]);
    const reach = this.stage.camera.pixels * 2.2;
    this.slow = pointerType === "mouse" && Math.hypot(x - offsetX, y - offsetY) < reach ? 0.2 : 1;
    return away(nearest) < (REACH[pointerType] ?? REACH.touch) ? nearest : null;
  }

  press(event) {
    if (this.stage.walker.ended) return;
    const handle = this.find(event);
    if (!handle) return;
    this.stage.canvas.setPointerCapture(event.pointerId);
    const { angle } = this.stage.parts[handle.part + 1];
    const along = handle.side ? turned(angle, handle.side, 0) : turned(angle, 0, -1);
    const index = 2 * handle.part + (handle.side ? 0 : 1);
    const from = [event.offsetX, event.offsetY], scale = this.stage.walker.design[index];
    this.held = { ...handle, along, index, from, scale };
    this.stage.canvas.classList.add("holding");
  }

  move(event) {
    if (!this.held) {
      this.near = this.find(event);
      this.stage.canvas.classList.toggle("near", !!this.near);
      return;
    }
    const { along, index, from, scale, side } = this.held;
    const dx = (event.offsetX - from[0]) / this.stage.camera.pixels;
    const dy = (from[1] - event.offsetY) / this.stage.camera.pixels;
    const pulled = (along[0] * dx + along[1] * dy) * (side ? 2 : 1); // m; an edge moves both
    const design = [...this.stage.walker.design];
    design[index] = limited(scale + (pulled * SCALE) / ORIGINAL_SIZES[index]);
    this.change(design);
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
    if (this.stage.walker.ended) return;
    const shown = this.held ?? this.near;
    for (const handle of handles(this.stage)) {
      const same = shown && handle.part === shown.part && handle.side === shown.side;
      if (handle.side && !same && this.slow === 1 && !this.held) continue;
      context.beginPath();
      context.arc(handle.pixels[0], handle.pixels[1], same ? 8 : handle.side ? 3 : 5, 0, 7);
      context.fillStyle = same ? this.stage.colors.accent : "#fff";
      context.strokeStyle = this.stage.colors.outline;
      context.lineWidth = 1.5;
      context.fill();
      context.stroke();
    }
    if (!shown) return;
    const index = 2 * shown.part + (shown.side ? 0 : 1);
    const text = `${DIMENSIONS[index]} ${Math.round(100 * this.stage.walker.design[index])} %`;
    const { pixels } = handles(this.stage).find(
      (handle) => handle.part === shown.part && handle.side === shown.side);
    context.font = "600 13px system-ui, sans-serif";
    context.textAlign = "left";
    const width = context.measureText(text).width;
    const left = Math.min(pixels[0] + 16, this.stage.camera.width - width - 14);
    context.fillStyle = "rgba(20, 20, 30, 0.82)";
    context.beginPath();
    context.roundRect(left, pixels[1] - 13, width + 14, 24, 6);
    context.fill();
    context.fillStyle = "#fff";
    context.fillText(text, left + 7, pixels[1] + 4);
  }
}

/** Eight sliders in a table of parts; change(design) as above. */
export class Sliders {
  constructor(element, change) {
    this.inputs = DIMENSIONS.map((name, i) => {
      const row = document.createElement("label");
      row.className = "slider";
      row.innerHTML = `<span>${name.split(" ").at(-1)}</span><span class="track">
        <input type="range" min="${SMALLEST}" max="${LARGEST}" step="any" aria-label="${name}">
        <i class="learned" title="learned"></i></span><output></output>`;
      const input = /** @type {HTMLInputElement} */ (row.querySelector("input"));
      input.addEventListener("input", () => change(this.inputs.map((other) => Number(other.value))));
      input.addEventListener("keydown", (event) => { // without steps, arrows need one
        const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
        if (!by) return;
        event.preventDefault();
        input.value = String(limited(Number(input.value) + 0.05 * by));
        input.dispatchEvent(new Event("input"));
      });
      if (i % 2 === 0) {
        const part = document.createElement("fieldset");
        part.innerHTML = `<legend><i class="leg-${i < 4 ? 1 : 2}"></i>${PARTS[1 + i / 2]}</legend>`;
        element.append(part);
      }
      element.lastElementChild.append(row);
      return input;
    });
  }

  show(design, learned) {
    design.forEach((scale, i) => {
      const input = this.inputs[i], row = input.closest("label");
      if (Number(input.value) !== scale) input.value = String(scale);
      input.setAttribute("aria-valuetext", `${Math.round(100 * scale)} % of the original`);
      row.querySelector("output").textContent = `${Math.round(100 * scale)} %`;
      const share = (learned[i] - SMALLEST) / (LARGEST - SMALLEST);
      const mark = /** @type {HTMLElement} */ (row.querySelector(".learned"));
      mark.style.left = `calc(9px + ${share} * (100% - 18px))`; // the thumb's
    });
  }
}
