// A canvas on which a walker or an ant walks in real time, course after course.

import { antLook } from "./ant.js";
import { Player, TASKS } from "./engine.js";
import { themeColors, walkerLook } from "./scene.js";

const REST = 1.3; // s that an ended course stays in the picture

/**
 * How a task looks.
 *
 * makeCamera(): with follow(player, root, width, height) and toPixels(point)
 * blend(before, after, share): the parts between two steps
 * draw(context, camera, player, parts, colors)
 * handles(stage): where a body can be taken, each with its dimensions' `indices` in a design and
 *   pull(design, dx, dy), the design after so many pixels
 * middle(stage): x, y of the body in the picture and how far it reaches, in pixels
 * match(players, cameras): shows several in the same scale
 * metres(player): how far it has come
 */
const LOOKS = { walker: walkerLook, ant: antLook };

/**
 * Walks with a policy and a body.
 *
 * hooks: stepped(stage) after every step, ended(stage) when a course is over, again(stage) when its
 * picture has been seen, drawn(stage, context) after every picture.
 */
export class Stage {
  constructor(engine, canvas, hooks = {}) {
    this.engine = engine;
    this.canvas = canvas;
    this.hooks = hooks;
    /** @type {Record<string, Player>} */
    this.players = {}; // by task
    this.cameras = {};
    this.colors = themeColors();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colors = themeColors();
      this.draw();
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.due = 0; // steps
    this.resting = 0; // s
  }

  /** task: its name; the others as of Player.start. */
  start(task, policy, design, course) {
    this.look = LOOKS[task];
    this.player = this.players[task] ??= new Player(this.engine, TASKS[task]);
    this.camera = this.cameras[task] ??= this.look.makeCamera();
    this.player.start(policy, design, course);
    this.before = this.player.parts;
    this.due = this.resting = 0;
    this.camera.ready = false;
    this.resize();
  }

  /** Lets time pass: so much for the player, and so much for who watches. */
  pass(seconds, watched) {
    if (this.player.ended) {
      this.resting += watched;
      if (this.resting > REST) this.hooks.again?.(this);
      return;
    }
    this.due += seconds * this.player.task.stepsPerSecond;
    while (this.due >= 1 && !this.player.ended) {
      this.due -= 1;
      this.before = this.player.parts;
      this.player.step();
      this.hooks.stepped?.(this);
      if (this.player.ended) {
        this.due = 1;
        this.hooks.ended?.(this);
      }
    }
  }

  changeBody(design) {
    if (this.player.ended) return;
    this.player.changeBody(design);
    this.before = this.player.parts;
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
    this.parts = this.look.blend(this.before, this.player.parts, Math.min(this.due, 1));
    const { clientWidth, clientHeight } = this.canvas;
    if (!still)
      this.camera.follow(this.player, this.parts[0], clientWidth, clientHeight);
    this.look.draw(context, this.camera, this.player, this.parts, this.colors);
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
