// The stage: the camera that a person steers, the frames, the dividing line, the captured views, dropped files.

import { Backdrop } from './backdrop.js';
import { Gizmo } from './gizmo.js';
import { place } from './photograph.js';
import { Picture } from './picture.js';
import { View, clamp } from './space.js';

const $ = (id) => document.getElementById(id);

export class Stage {
  constructor(app) {
    this.app = app;
    this.root = $('stage');
    this.canvas = $('picture');
    this.picture = new Picture(this.canvas);
    this.backdrop = new Backdrop(app);
    this.gizmo = new Gizmo(app, this, $('overlay'));
    this.split = 0.5;
    this.side = false;
    this.camera = null;
    // The camera of the captured view that somebody points at.
    this.pointed = null;
    this.intervals = [];
    new ResizeObserver(() => this.draw()).observe(this.root);
    this.bindOrbit();
    this.bindSplit();
    this.bindDrop();
  }

  // ---- geometry

  size() {
    const { clientWidth: width, clientHeight: height } = this.root;
    return { width, height };
  }

  square() {
    const { width, height } = this.size();
    // The dome of lights around the picture needs room too.
    const side = Math.min(width * (width < 600 ? 0.6 : 0.74), height * 0.82, 860);
    return { cx: width / 2, cy: height / 2, side };
  }

  view() {
    const { cx, cy, side } = this.square();
    return new View(this.camera, cx, cy, side);
  }

  reset() {
    this.camera = { ...this.app.session.camera };
    this.picture.panes = [];
    this.captured();
    const first = !localStorage.getItem('lumi-orbited');
    const zoom = matchMedia('(pointer: coarse)').matches ? 'pinch' : 'scroll';
    $('hint').textContent = `Drag to orbit · ${zoom} to zoom`;
    $('hint').hidden = !first;
  }

  // ---- frames

  // Asks for the view as it is now; `moving` if more is about to come.
  request(moving = false) {
    const { app } = this;
    if (!app.session || !this.camera) return;
    const ask = { node: app.head, camera: this.camera, moving, look: app.look.shown() };
    const part = app.shining.request();
    if (part) {
      Object.assign(ask, part);
    } else if (app.draft && app.node(app.draft.node)) {
      const path = app.path(app.head);
      const at = path.findIndex((n) => n.id === app.draft.node);
      if (at > 0) {
        ask.node = path[at].parent;
        ask.draft = [app.draft.edit, ...path.slice(at + 1).map((n) => n.edit)];
      }
    }
    if (app.compare !== null) ask.compare = app.compare;
    app.frames?.ask(ask);
    if (!this.drawing) this.drawing = requestAnimationFrame(() => this.draw());
  }

  frame(header, panes, asked) {
    this.picture.show(header, panes);
    this.draw();
    const now = performance.now();
    const { metrics } = this.app;
    const took = asked ? now - asked.since : 0;
    if (asked) metrics.frames.push({ at: now, took, draft: Boolean(asked.request.draft), ...header });
    if (metrics.frames.length > 5000) metrics.frames.splice(0, 1000);
    if (asked?.request.draft) metrics.edits.push(took);
    if (metrics.started !== null && asked && asked.request.node === this.app.head && !asked.request.draft
        && asked.since > metrics.started) {
      metrics.edits.push(now - metrics.started);
      metrics.started = null;
    }
    this.timing(header, took, asked?.request.moving);
    if (!asked?.request.moving) this.root.classList.add('settled');
  }

  timing(header, took, moving) {
    const now = performance.now();
    if (moving && this.last && now - this.last < 400) {
      this.intervals.push(now - this.last);
      if (this.intervals.length > 40) this.intervals.shift();
    }
    this.last = moving ? now : null;
    const parts = [];
    if (header.edit_ms > 0) parts.push(`edit ${header.edit_ms.toFixed(0)} ms`);
    parts.push(`render ${header.render_ms.toFixed(0)} ms`);
    parts.push(`on screen in ${took.toFixed(0)} ms`);
    if (this.intervals.length > 5) {
      const sorted = [...this.intervals].sort((a, b) => a - b);
      parts.push(`${(1000 / sorted[sorted.length >> 1]).toFixed(0)} fps`);
    }
    parts.push(`${header.width} px`);
    $('timing').textContent = parts.join('  ·  ');
  }

  draw() {
    this.drawing = null;
    if (!this.camera) return;
    const { width, height } = this.size();
    const { shown: photograph } = this.app.photograph;
    const comparing = this.app.compare !== null || photograph !== null;
    const layout = comparing ? (this.side ? 'side' : 'split') : 'one';
    const one = this.square();
    const half = Math.min(one.side, width * 0.4);
    const squares = layout === 'side'
      ? [0.25, 0.75].map((at) => ({ ...one, cx: at * width, side: half }))
      : [one];
    const { background } = this.app.look;
    const behind = background === 'environment'
      ? (square, left, right) => this.backdrop.behind(this.camera, square, left, right, height)
      : null;
    this.picture.draw({ width, height, layout, squares, split: this.split, background, behind, photograph: photograph?.image });
    const line = $('split');
    line.hidden = layout !== 'split';
    line.style.left = `${this.split * 100}%`;
    line.setAttribute('aria-valuenow', String(Math.round(this.split * 100)));
    $('tags').hidden = !comparing;
    if (comparing) {
      const tag = (id) => (id ? `${id} · ${this.app.history.title(id)}` : 'Captured');
      $('tag-a').textContent = photograph ? `Photograph ${photograph.name}` : tag(this.app.compare);
      $('tag-b').textContent = tag(this.app.head);
      $('side').setAttribute('aria-pressed', String(this.side));
    }
    this.gizmo.draw(layout === 'side' ? null : this.view());
    this.markNearest();
  }

  toggleSide() {
    this.side = !this.side;
    this.draw();
  }

  // ---- orbit and zoom

  turn(azimuth, elevation, moving = true) {
    this.app.photograph.leave();
    const c = this.camera;
    c.azimuth = (c.azimuth + azimuth) % (2 * Math.PI);
    c.elevation = clamp(c.elevation + elevation, -1.45, 1.45);
    this.moved(moving);
  }

  zoom(factor, moving = true) {
    this.app.photograph.leave();
    this.camera.distance = clamp(this.camera.distance * factor, 1.3, 8);
    this.moved(moving);
  }

  // The full picture follows when nothing has moved for a moment.
  moved(moving) {
    this.request(moving);
    clearTimeout(this.still);
    if (moving) this.still = setTimeout(() => this.request(false), 140);
    if (!localStorage.getItem('lumi-orbited')) {
      localStorage.setItem('lumi-orbited', '1');
      $('hint').hidden = true;
    }
  }

  // Glides to a camera along the shorter way; resolves when it is there.
  glide(target) {
    if (this.app.photograph.shown) this.app.photograph.leave();
    const from = { ...this.camera };
    const turn = ((target.azimuth - from.azimuth + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
    const start = performance.now();
    const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
    let there;
    const arrived = new Promise((done) => { there = done; });
    const step = (now) => {
      const t = still ? 1 : clamp((now - start) / 450, 0, 1);
      const s = t * t * (3 - 2 * t);
      const mix = (a, b) => a + (b - a) * s;
      this.camera = {
        azimuth: from.azimuth + turn * s,
        elevation: mix(from.elevation, target.elevation),
        distance: mix(from.distance, target.distance),
        fov: mix(from.fov, target.fov),
      };
      this.moved(t < 1);
      if (t < 1) requestAnimationFrame(step);
      else there();
    };
    requestAnimationFrame(step);
    return arrived;
  }

  bindOrbit() {
    const { canvas } = this;
    const fingers = new Map();
    let pinch = null;
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      this.root.classList.add('dragging');
    });
    canvas.addEventListener('pointermove', (event) => {
      const before = fingers.get(event.pointerId);
      if (!before || !this.camera) return;
      const now = [event.clientX, event.clientY];
      fingers.set(event.pointerId, now);
      if (fingers.size === 2) {
        const [a, b] = [...fingers.values()];
        const apart = Math.hypot(a[0] - b[0], a[1] - b[1]);
        if (pinch) this.zoom(pinch / apart);
        pinch = apart;
        return;
      }
      const speed = 3.2 / this.square().side;
      this.turn(-(now[0] - before[0]) * speed, (now[1] - before[1]) * speed);
    });
    const up = (event) => {
      fingers.delete(event.pointerId);
      pinch = null;
      if (!fingers.size) {
        this.root.classList.remove('dragging');
        this.moved(false);
      }
    };
    canvas.addEventListener('pointerup', up);
    canvas.addEventListener('pointercancel', up);
    this.root.addEventListener('wheel', (event) => {
      if (!this.camera || event.target.closest('.views')) return;
      event.preventDefault();
      this.zoom(Math.exp(clamp(event.deltaY, -120, 120) * 0.0014));
    }, { passive: false });
    canvas.addEventListener('dblclick', () => this.app.session && this.glide(this.app.session.camera));
    canvas.addEventListener('keydown', (event) => {
      const step = event.shiftKey ? 0.3 : 0.08;
      const keys = {
        ArrowLeft: () => this.turn(-step, 0),
        ArrowRight: () => this.turn(step, 0),
        ArrowUp: () => this.turn(0, step),
        ArrowDown: () => this.turn(0, -step),
        '+': () => this.zoom(0.92),
        '=': () => this.zoom(0.92),
        '-': () => this.zoom(1.09),
        Home: () => this.glide(this.app.session.camera),
      };
      if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
      keys[event.key]();
      event.preventDefault();
    });
  }

  // ---- the dividing line

  bindSplit() {
    const line = $('split');
    const to = (value) => {
      this.split = clamp(value, 0.02, 0.98);
      this.draw();
    };
    line.addEventListener('pointerdown', (event) => line.setPointerCapture(event.pointerId));
    line.addEventListener('pointermove', (event) => {
      if (!line.hasPointerCapture(event.pointerId)) return;
      const box = this.root.getBoundingClientRect();
      to((event.clientX - box.left) / box.width);
    });
    line.addEventListener('keydown', (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
      if (!step) return;
      to(this.split + step);
      event.preventDefault();
    });
  }

  // ---- captured views

  captured() {
    const { app } = this;
    const list = $('views');
    list.replaceChildren();
    const label = document.createElement('h2');
    label.textContent = 'Captured';
    label.title = 'The views that the scene was captured from';
    list.append(label);
    app.session.inputs.forEach((view, i) => {
      const button = document.createElement('button');
      button.title = `Look from ${view.name}: ${place(view.camera)}`;
      button.setAttribute('aria-label', `Look from captured view ${view.name}, ${place(view.camera)}`);
      const image = document.createElement('img');
      image.alt = '';
      image.loading = 'lazy';
      image.src = app.url(`inputs/${i}`);
      button.append(image);
      button.onclick = () => this.glide(view.camera);
      const point = (camera) => {
        this.pointed = camera;
        this.draw();
      };
      button.onpointerenter = (event) => event.pointerType === 'mouse' && point(view.camera);
      button.onfocus = () => button.matches(':focus-visible') && point(view.camera);
      button.onpointerleave = () => point(null);
      button.onblur = () => point(null);
      list.append(button);
    });
  }

  // The captured view nearest to where the camera is now, which is the one that P compares with.
  markNearest() {
    const nearest = this.app.photograph.nearest(this.camera);
    $('views').querySelectorAll('button').forEach((button, i) => button.classList.toggle('nearest', i === nearest));
  }

  // ---- dropped files

  bindDrop() {
    const cover = $('drop');
    const files = (event) => [...(event.dataTransfer?.types ?? [])].includes('Files');
    let depth = 0;
    window.addEventListener('dragenter', (event) => {
      if (!files(event)) return;
      depth += 1;
      cover.hidden = false;
    });
    window.addEventListener('dragleave', (event) => {
      if (!files(event)) return;
      depth -= 1;
      cover.hidden = depth > 0 ? cover.hidden : true;
    });
    window.addEventListener('dragover', (event) => files(event) && event.preventDefault());
    window.addEventListener('drop', (event) => {
      if (!files(event)) return;
      event.preventDefault();
      depth = 0;
      cover.hidden = true;
      this.app.dialogs.dropped(event.dataTransfer).catch((e) => this.app.failed('drop', e.message));
    });
  }
}
