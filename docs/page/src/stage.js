// A canvas on which a walker walks in real time, course after course.

import { STEPS_PER_SECOND, Walker } from "./engine.js";
import { Camera, blend, drawScene, themeColors } from "./scene.js";

const REST = 1.3; // s that an ended course stays in the picture

/**
 * Walks with a policy and a body.
 *
 * hooks: stepped(stage) after every step, ended(stage) when a course is over, again(stage) when its
 * picture has been seen, drawn(stage, context) after every picture.
 */
export class Stage {
  constructor(engine, canvas, hooks = {}) {
    this.walker = new Walker(engine);
    this.canvas = canvas;
    this.hooks = hooks;
    this.camera = new Camera();
    this.colors = themeColors();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colors = themeColors();
      this.draw();
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.due = 0; // steps
    this.resting = 0; // s
  }

  start(weights, design, course) {
    this.walker.start(weights, design, course);
    this.before = this.walker.parts;
    this.due = this.resting = 0;
    this.camera.ready = false;
    this.resize();
  }

  /** Lets time pass: so much for the walker, and so much for who watches. */
  pass(seconds, watched) {
    if (this.walker.ended) {
      this.resting += watched;
      if (this.resting > REST) this.hooks.again?.(this);
      return;
    }
    this.due += seconds * STEPS_PER_SECOND;
    while (this.due >= 1 && !this.walker.ended) {
      this.due -= 1;
      this.before = this.walker.parts;
      this.walker.step();
      this.hooks.stepped?.(this);
      if (this.walker.ended) {
        this.due = 1;
        this.hooks.ended?.(this);
      }
    }
  }

  changeBody(design) {
    if (this.walker.ended) return;
    this.walker.changeBody(design);
    this.before = this.walker.parts;
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(devicePixelRatio || 1, 2.5);
    const [width, height] = [clientWidth, clientHeight].map((side) => Math.round(side * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height)
      Object.assign(this.canvas, { width, height });
    this.ratio = ratio;
    this.draw();
  }

  draw(still = false) {
    if (!this.before) return;
    const context = this.canvas.getContext("2d");
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.parts = blend(this.before, this.walker.parts, Math.min(this.due, 1));
    const { clientWidth, clientHeight } = this.canvas;
    if (!still)
      this.camera.follow(this.walker, this.parts[0], clientWidth, clientHeight);
    drawScene(context, this.camera, this.walker, this.parts, this.colors);
    this.hooks.drawn?.(this, context);
  }
}

/** Runs stages while they are in view. options: playing, speed, and slow() of the time, 0 to 1. */
export class Clock {
  constructor(stages, element) {
    this.stages = stages;
    this.playing = true;
    this.speed = 1;
    this.slow = () => 1;
    this.seen = this.asked = false;
    this.last = 0; // ms
    new IntersectionObserver(([entry]) => {
      this.seen = entry.isIntersecting;
      this.last = 0;
      if (this.seen) this.ask();
    }).observe(element);
    document.addEventListener("visibilitychange", () => {
      this.last = 0;
      if (this.seen) this.ask();
    });
  }

  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      const passed = this.last ? Math.min((now - this.last) / 1000, 0.1) : 0;
      this.last = now;
      const slow = this.slow();
      for (const stage of this.stages) {
        if (this.playing && slow) stage.pass(passed * this.speed * slow, passed);
        stage.draw(slow === 0);
      }
      if (this.seen && !document.hidden) this.ask();
    });
  }
}
