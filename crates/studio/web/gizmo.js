// Lights drawn over the picture, and the handles to move them: SVG, so that every handle has a name and the focus.

import { KINDS, movedTo, placeOf } from './kinds.js';
import { add, cartesian, clamp, cross, length, mul, onDome, shown, sub, unit } from './space.js';

const NS = 'http://www.w3.org/2000/svg';
// Cameras are marked on a dome of this radius, in their true direction.
const MARKS = 1.3;
// What knobs change, in model space: the least and the most, and how it grows with the scene's scale.
const KNOBS = { power: [1, 20000, 2], size: [0.05, 6, 1], strength: [0.003, 300, 0], angle: [2, 170, 0] };
const AXES = [['x', [1, 0, 0]], ['y', [0, 1, 0]], ['z', [0, 0, 1]]];

function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// Linear colour with its largest channel at 1, as a CSS colour.
export function css(color) {
  const top = Math.max(...color, 1e-6);
  const encode = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
  return `rgb(${color.map((v) => Math.round(255 * encode(clamp(v / top, 0, 1)))).join(' ')})`;
}

export class Gizmo {
  constructor(app, stage, root) {
    Object.assign(this, { app, stage, root });
    this.key = '';
    this.held = null;
    // Where a captured view was taken, while somebody points at it.
    this.mark = svg('g', { class: 'mark' }, svg('circle', { r: 14 }), svg('path', { d: 'M-6 -3h3l1-1.500h4l1 1.500h3v8h-12zM0 -1.500a2.300 2.300 0 1 0 0 4.600 2.300 2.300 0 1 0 0-4.600' }));
  }

  // Redraws for a camera; `null` hides everything.
  draw(view) {
    const { app } = this;
    this.view = view;
    const path = view && app.session ? app.path(app.head) : [];
    // What came before the last `set` no longer shines.
    const start = Math.max(0, path.findLastIndex((n) => n.edit?.mode === 'set'));
    const nodes = path.slice(start).filter((n) => n.edit);
    const edits = nodes.map((n) => (app.draft?.node === n.id ? app.draft.edit : n.edit));
    const key = JSON.stringify([Boolean(view), app.selected,
      nodes.map((n, i) => [n.id, edits[i].mode, edits[i].lights.map((l) => l.kind)])]);
    if (key !== this.key && !this.held) {
      this.key = key;
      this.build(nodes);
    }
    if (!view) return;
    nodes.forEach((node, i) => edits[i].lights.forEach((light, k) => this.place(node, light, k)));
    this.placeMark();
    for (const [key, { group }] of this.parts) group.classList.toggle('hidden', !app.shining.shows(key));
  }

  placeMark() {
    const { pointed } = this.stage;
    if (!pointed) {
      this.mark.remove();
      return;
    }
    const p = cartesian({ ...pointed, distance: MARKS });
    const { x, y } = this.view.project(p);
    this.mark.setAttribute('transform', `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
    this.mark.classList.toggle('far', this.view.behind(p));
    if (!this.mark.isConnected) this.root.append(this.mark);
  }

  build(nodes) {
    this.parts = new Map();
    const focused = this.root.contains(document.activeElement) ? document.activeElement.getAttribute('aria-label') : null;
    this.root.replaceChildren(svg('defs', {},
      svg('radialGradient', { id: 'halo' },
        svg('stop', { offset: '0', 'stop-color': 'currentColor', 'stop-opacity': '.55' }),
        svg('stop', { offset: '1', 'stop-color': 'currentColor', 'stop-opacity': '0' }))));
    for (const node of nodes) {
      node.edit.lights.forEach((light, k) => {
        const active = node.id === this.app.selected && k === 0;
        const group = svg('g', { class: active ? 'light active' : 'light' });
        const part = light.kind === 'environment' ? this.buildSun(node, active) : this.buildLamp(node, light, active);
        group.append(...part.elements);
        this.parts.set(`${node.id}.${k}`, { ...part, group, active });
        this.root.append(group);
      });
    }
    // The one being edited lies on top.
    const active = this.root.querySelector('.active');
    if (active) this.root.append(active);
    if (focused === null) return;
    // The handle that had the focus; that of a light which has just been selected has become the lamp itself.
    const handles = [...this.root.querySelectorAll('.handle')];
    const same = handles.find((h) => h.getAttribute('aria-label') === focused) ?? active?.querySelector('.handle');
    same?.focus({ preventScroll: true });
  }

  // A handle that can be dragged, focused and moved by arrow keys.
  handle(element, label, drag, keys) {
    element.classList.add('handle');
    element.setAttribute('tabindex', '0');
    element.setAttribute('role', 'button');
    element.setAttribute('aria-label', label);
    element.append(svg('title'));
    element.querySelector('title').textContent = label;
    element.addEventListener('pointerdown', (event) => {
      event.stopPropagation();
      event.preventDefault();
      element.focus({ preventScroll: true });
      element.setPointerCapture(event.pointerId);
      this.held = { element, node: this.app.selected, x: event.clientX, y: event.clientY, moved: false };
      this.stage.root.classList.add('holding');
    });
    // The browser would take the finger for scrolling: `touch-action` does not reach into SVG everywhere.
    element.addEventListener('touchstart', (event) => event.preventDefault(), { passive: false });
    element.addEventListener('pointermove', (event) => {
      // Another step may have been selected meanwhile, from another page: its light is not the one that was taken.
      if (this.held?.element !== element || this.held.node !== this.app.selected) return;
      const dx = event.clientX - this.held.x;
      const dy = event.clientY - this.held.y;
      if (!dx && !dy) return;
      Object.assign(this.held, { x: event.clientX, y: event.clientY, moved: true });
      const box = this.stage.root.getBoundingClientRect();
      drag({ x: event.clientX - box.left, y: event.clientY - box.top, dx, dy });
    });
    const up = () => {
      if (this.held?.element !== element) return;
      const { moved } = this.held;
      this.held = null;
      this.stage.root.classList.remove('holding');
      if (moved) this.app.commit();
    };
    element.addEventListener('pointerup', up);
    element.addEventListener('pointercancel', up);
    element.addEventListener('keydown', (event) => {
      const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!by || !keys) return;
      event.preventDefault();
      event.stopPropagation();
      keys(...mul(by, event.shiftKey ? 4 : 1));
      clearTimeout(this.later);
      this.later = setTimeout(() => this.app.commit(), 350);
    });
    return element;
  }

  // ---- environments: a horizon ring with the brightest direction on it

  buildSun(node, active) {
    const ring = svg('path', { class: 'ring' });
    const sun = svg('g', { class: 'sun' }, svg('circle', { r: 26, fill: 'url(#halo)' }), svg('circle', { r: 8, class: 'core' }));
    if (active) {
      const turn = (degrees) => {
        const light = this.app.edit().lights[0];
        this.app.change({ rotate: (((light.rotate + degrees) % 360) + 540) % 360 - 180 });
      };
      const drag = ({ x, y, dx }) => {
        // Around the ring: the change of azimuth of the point below the pointer on the dome.
        const at = (px) => {
          const p = this.view.onSphere(px, y, 1.45, this.far);
          return Math.atan2(p[1], p[0]);
        };
        const change = at(x) - at(x - dx);
        turn((Math.atan2(Math.sin(change), Math.cos(change)) * 180) / Math.PI);
      };
      this.handle(sun, 'Rotate the environment', drag, (x) => turn(4 * x));
    } else {
      this.selects(sun, node, 'environment');
    }
    return { elements: [ring, sun], ring, sun };
  }

  placeSun(part, light) {
    const map = this.app.map(light.map);
    const [azimuth, elevation] = map?.brightest ?? [0, 30];
    const a = ((azimuth + light.rotate) * Math.PI) / 180;
    const e = (elevation * Math.PI) / 180;
    const p = mul([Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)], 1.45);
    const at = this.view.project(p);
    if (part.active) this.far = this.view.behind(p);
    const points = [];
    for (let i = 0; i <= 72; i += 1) {
      const t = (i * Math.PI) / 36;
      const q = this.view.project([1.45 * Math.cos(t), 1.45 * Math.sin(t), 0]);
      points.push(`${q.x.toFixed(1)} ${q.y.toFixed(1)}`);
    }
    part.ring.setAttribute('d', `M${points.join('L')}`);
    part.sun.setAttribute('transform', `translate(${at.x} ${at.y})`);
    part.sun.style.color = map ? css(map.mean) : '#fff';
    part.group.classList.toggle('far', this.view.behind(p));
  }

  // ---- lamps: everything but environments

  buildLamp(node, light, active) {
    const { kind } = light;
    const beam = svg('line', { class: 'beam' });
    const square = kind === 'area' ? svg('polygon', { class: 'square' }) : null;
    const cone = kind === 'spot' ? svg('path', { class: 'cone' }) : null;
    const lamp = svg('g', { class: 'lamp' }, svg('circle', { class: 'halo', r: 30, fill: 'url(#halo)' }), svg('circle', { r: 9, class: 'core' }));
    const elements = [beam, square, cone, lamp].filter(Boolean);
    const part = { elements, beam, square, cone, lamp, axes: [] };
    if (!active) {
      this.selects(lamp, node, kind);
      return part;
    }
    this.handle(lamp, `Move the ${KINDS[kind].name.toLowerCase()} around the scene`, ({ x, y }) => {
      const p = this.position();
      const radius = length(p);
      const q = this.view.onSphere(x, y, shown(radius), this.view.behind(p));
      this.move(mul(unit(q), radius));
    }, (dx, dy) => this.rotate(0.06 * dx, -0.06 * dy));
    for (const [name, axis] of light.position ? AXES : []) {
      const line = svg('line', { class: `axis ${name}` });
      const tip = svg('g', { class: `tip ${name}` }, svg('circle', { r: 11, class: 'grip' }), svg('circle', { r: 5 }));
      const label = `Move along ${name.toUpperCase()}`;
      this.handle(tip, label, ({ dx, dy }) => this.slide(axis, dx, dy), (x, y) => this.shift(axis, 0.08 * (x - y)));
      part.axes.push({ axis, line, tip });
      elements.push(line, tip);
    }
    const bright = kind === 'sun' ? 'strength' : 'power';
    part.power = this.knob('Power', 'M3 -1 0 -6 -1 -1 -3 1 0 6 1 1Z', ({ dy }) => this.scale(bright, -dy * 0.012), (x, y) => this.scale(bright, 0.1 * (x - y)));
    elements.push(part.power);
    const wide = { area: 'size', spot: 'angle' }[kind];
    if (wide) {
      part.size = this.knob('Size', 'M-4 -1V-4H-1M4 1V4H1', ({ dx, dy }) => this.scale(wide, (dx + dy) * 0.01), (x, y) => this.scale(wide, 0.1 * (x - y)));
      elements.push(part.size);
    }
    if (light.target) {
      part.aim = this.knob('Aim', 'M-5 0H5M0 -5V5', ({ x, y }) => {
        const target = this.app.toModel.point(this.app.edit().lights[0].target);
        const p = this.view.onPlane(x, y, target);
        const r = length(p);
        this.app.change({ target: this.app.toModel.inverse(r > 1.4 ? mul(p, 1.4 / r) : p) });
      }, (x, y) => {
        const target = this.app.toModel.point(this.app.edit().lights[0].target);
        const p = add(target, add(mul(this.view.right, 0.05 * x), mul(this.view.down, 0.05 * y)));
        this.app.change({ target: this.app.toModel.inverse(p) });
      });
      elements.push(part.aim);
    }
    return part;
  }

  knob(label, icon, drag, keys) {
    const knob = svg('g', { class: `knob ${label.toLowerCase()}` }, svg('circle', { r: 11 }), svg('path', { d: icon }));
    return this.handle(knob, label, drag, keys);
  }

  // Another light of this look: a press selects its step.
  selects(element, node, kind) {
    element.classList.add('handle');
    element.setAttribute('tabindex', '0');
    element.setAttribute('role', 'button');
    element.setAttribute('aria-label', `Edit the ${KINDS[kind].name.toLowerCase()} of step ${node.id}`);
    element.addEventListener('pointerdown', (event) => event.stopPropagation());
    const select = () => this.app.select(node.id);
    element.addEventListener('click', select);
    element.addEventListener('keydown', (event) => ['Enter', ' '].includes(event.key) && select());
  }

  place(node, light, k) {
    const part = this.parts.get(`${node.id}.${k}`);
    if (!part) return;
    if (light.kind === 'environment') {
      this.placeSun(part, light);
      return;
    }
    const { view } = this;
    const p = placeOf(light, this.app.toModel);
    const dome = onDome(p);
    const at = view.project(dome);
    const put = (element, x, y) => element.setAttribute('transform', `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
    part.group.style.color = css(light.color);
    part.group.classList.toggle('far', view.behind(p));
    put(part.lamp, at.x, at.y);
    // A sun glows as a lamp that brings as much from three radii away.
    const watts = light.from ? light.strength * 4 * Math.PI * 9 : light.power * this.app.toModel.scale ** 2;
    const glow = clamp(14 + 7 * Math.log10(Math.max(watts, 1)), 14, 44);
    part.lamp.querySelector('.halo').setAttribute('r', glow.toFixed(1));
    const target = light.target ? this.app.toModel.point(light.target) : [0, 0, 0];
    const aim = view.project(target);
    this.line(part.beam, at, this.toward(at, aim, light.kind === 'point' ? 0.45 : 1));
    if (part.square) this.placeSquare(part.square, light, p, dome, target);
    if (part.cone) this.placeCone(part.cone, light, p, at, target);
    if (!part.active) return;
    for (const { axis, line, tip } of part.axes) {
      const end = view.project(add(dome, mul(axis, 0.26)));
      this.line(line, at, end);
      put(tip, end.x, end.y);
    }
    put(part.power, at.x - 30, at.y - 26);
    if (part.size) put(part.size, at.x + 32, at.y + 26);
    if (part.aim) put(part.aim, aim.x, aim.y);
  }

  // The square as it hangs at the light's place on the dome, its size shrunk as its distance is.
  placeSquare(polygon, light, p, dome, target) {
    const normal = unit(sub(target, p));
    const up = Math.abs(normal[2]) > 0.99 ? [0, 1, 0] : [0, 0, 1];
    const side = unit(cross(normal, up));
    const other = cross(normal, side);
    const half = (0.5 * light.size * this.app.toModel.scale * length(dome)) / length(p);
    const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([u, v]) => {
      const q = this.view.project(add(dome, add(mul(side, u * half), mul(other, v * half))));
      return `${q.x.toFixed(1)},${q.y.toFixed(1)}`;
    });
    polygon.setAttribute('points', corners.join(' '));
  }

  // Where the cone is cut at its target, and its sides from the lamp to there.
  placeCone(path, light, p, lamp, target) {
    const axis = unit(sub(target, p));
    const up = Math.abs(axis[2]) > 0.99 ? [0, 1, 0] : [0, 0, 1];
    const u = unit(cross(axis, up));
    const v = cross(axis, u);
    // Wide cones would leave the picture.
    const half = Math.min((0.5 * light.angle * Math.PI) / 180, 1.2);
    const radius = Math.min(Math.tan(half) * length(sub(target, p)), 2.5);
    const rim = Array.from({ length: 48 }, (_, i) => {
      const t = (i * Math.PI) / 24;
      return this.view.project(add(target, add(mul(u, radius * Math.cos(t)), mul(v, radius * Math.sin(t)))));
    });
    const text = (q) => `${q.x.toFixed(1)} ${q.y.toFixed(1)}`;
    // The rim's points farthest to either side of the beam, as it is seen.
    const middle = this.view.project(target);
    const side = (q) => (q.x - lamp.x) * (middle.y - lamp.y) - (q.y - lamp.y) * (middle.x - lamp.x);
    const sides = [...rim].sort((a, b) => side(a) - side(b));
    path.setAttribute('d', `M${rim.map(text).join('L')}ZM${text(sides[0])}L${text(lamp)}L${text(sides.at(-1))}`);
  }

  line(element, from, to) {
    element.setAttribute('x1', from.x);
    element.setAttribute('y1', from.y);
    element.setAttribute('x2', to.x);
    element.setAttribute('y2', to.y);
  }

  toward(from, to, share) {
    return { x: from.x + (to.x - from.x) * share, y: from.y + (to.y - from.y) * share };
  }

  // ---- what handles do, in model space

  position() {
    return placeOf(this.app.edit().lights[0], this.app.toModel);
  }

  // Never into the scene: lights must stand outside its ball.
  move(p) {
    const r = length(p);
    const kept = mul(p, clamp(r, 1.15, 12) / r);
    this.app.change(movedTo(this.app.edit().lights[0], kept, this.app.toModel));
  }

  rotate(azimuth, elevation) {
    const p = this.position();
    const r = length(p);
    const a = Math.atan2(p[1], p[0]) + azimuth;
    const e = clamp(Math.asin(clamp(p[2] / r, -1, 1)) + elevation, -1.5, 1.5);
    this.move(mul([Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)], r));
  }

  shift(axis, by) {
    this.move(add(this.position(), mul(axis, by)));
  }

  // Along an axis by as much as its arrow moves on the stage.
  slide(axis, dx, dy) {
    const p = this.position();
    const a = this.view.project(onDome(p));
    const b = this.view.project(onDome(add(p, mul(axis, 0.05))));
    const [ux, uy] = [(b.x - a.x) / 0.05, (b.y - a.y) / 0.05];
    const speed = Math.max(ux * ux + uy * uy, 400);
    this.shift(axis, clamp((dx * ux + dy * uy) / speed, -0.4, 0.4));
  }

  scale(field, by) {
    const light = this.app.edit().lights[0];
    const [low, high, power] = KNOBS[field];
    const unitScale = this.app.toModel.scale ** power;
    const value = clamp(light[field] * unitScale * Math.exp(by), low, high);
    this.app.change({ [field]: value / unitScale });
  }
}
