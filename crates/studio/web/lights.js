// The panel: add a light, and everything about the one that is selected.

import { post } from './api.js';
import { el, icon } from './dom.js';
import { KINDS, movedTo, placeOf } from './kinds.js';
import { above, number, short, vector, within } from './numbers.js';
import { cartesian, clamp, length, mul, spherical, sub, unit } from './space.js';

const MODES = { set: ['Replace', 'Replaces all light that was there'], add: ['Add', 'Shines together with what was there'], remove: ['Remove', 'Takes this light away'] };

// A new light as a person would first want it: key, fill and rim places in turn, relative to the camera.
export function fresh(kind, app) {
  const before = app.path(app.head).filter((n) => n.edit).length;
  if (kind === 'environment') {
    const map = app.maps[before % app.maps.length];
    return { kind, map: map.id, rotate: 0, strength: natural(map, app) };
  }
  const azimuth = app.stage.camera.azimuth + [0.75, -0.95, 2.45][before % 3];
  const position = cartesian({ azimuth, elevation: [0.75, 0.4, 0.6][before % 3], distance: USUAL });
  const { scale } = app.toModel;
  const exposure = luminance(app.session.exposure);
  const watts = [320, 200, 320][before % 3];
  const color = [[1, 0.82, 0.62], [0.62, 0.8, 1], [1, 1, 1]][before % 3];
  const digits = (v) => +v.toPrecision(2);
  if (kind === 'sun') {
    // What the same watts bring from there.
    const strength = digits(watts / (4 * Math.PI * USUAL ** 2) / exposure);
    return { kind, from: app.toModel.back(unit(position)), strength, angle: 0.526, color };
  }
  const light = {
    kind,
    position: app.toModel.inverse(position),
    // An area light shines to one side only: a quarter of the watts bring as much light.
    power: digits((watts * (kind === 'area' ? 0.25 : 1)) / (scale ** 2 * exposure)),
    color,
  };
  if (kind !== 'point') light.target = app.toModel.inverse([0, 0, 0]);
  if (kind === 'area') light.size = 1.2 / scale;
  // From there the scene is 32° wide: a cone that can be seen on it.
  if (kind === 'spot') Object.assign(light, { angle: 22, blend: 0.3 });
  return light;
}

// How many radii away new lights stand.
const USUAL = 3.6;
// Where lights may stand, in radii of the scene's ball.
const NEAREST = 1.05;
const FARTHEST = 20;

const luminance = ([r, g, b]) => Math.max(0.2126 * r + 0.7152 * g + 0.0722 * b, 1e-6);

// The strength of a map that makes the scene about as bright as it was captured: its illumination scale, twice the mean
// radiance times the exposure (docs/decisions/0013-illumination-scale.md), is 1 then.
function natural(map, app) {
  return +(0.5 / luminance(map.mean) / luminance(app.session.exposure)).toPrecision(2);
}

const decode = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
const encode = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);

function toHex(color) {
  const top = Math.max(...color, 1e-6);
  return `#${color.map((v) => Math.round(255 * encode(clamp(v / top, 0, 1))).toString(16).padStart(2, '0')).join('')}`;
}

function fromHex(hex) {
  const color = [1, 3, 5].map((i) => decode(parseInt(hex.slice(i, i + 2), 16) / 255));
  const top = Math.max(...color);
  return top > 0 ? color.map((v) => +(v / top).toFixed(4)) : [1, 1, 1];
}

// Chromaticity of a black body (Kim et al. 2002, cubic splines) as linear Rec. 709 with its largest channel at 1.
export function blackBody(kelvin) {
  const t = 1000 / kelvin;
  const x = kelvin < 4000
    ? -0.2661239 * t ** 3 - 0.2343589 * t ** 2 + 0.8776956 * t + 0.17991
    : -3.0258469 * t ** 3 + 2.1070379 * t ** 2 + 0.2226347 * t + 0.24039;
  let y = 3.081758 * x ** 3 - 5.8733867 * x ** 2 + 3.75112997 * x - 0.37001483;
  if (kelvin < 2222) y = -1.1063814 * x ** 3 - 1.3481102 * x ** 2 + 2.18555832 * x - 0.20219683;
  else if (kelvin < 4000) y = -0.9549476 * x ** 3 - 1.37418593 * x ** 2 + 2.09137015 * x - 0.16748867;
  const [X, Z] = [x / y, (1 - x - y) / y];
  const rgb = [3.2406 * X - 1.5372 - 0.4986 * Z, -0.9689 * X + 1.8758 + 0.0415 * Z, 0.0557 * X - 0.204 + 1.057 * Z];
  const top = Math.max(...rgb);
  return rgb.map((v) => +Math.max(v / top, 0).toFixed(4));
}

export class Lights {
  constructor(app, root) {
    Object.assign(this, { app, root, key: null, fields: [] });
  }

  // Rebuilt only when there is something else to show: a slider that is being dragged stays.
  render() {
    const { app } = this;
    const edit = app.edit();
    const key = JSON.stringify([app.session.id, app.selected, app.head, edit?.mode, edit?.lights[0]?.kind, app.maps.length]);
    if (key !== this.key) {
      this.key = key;
      this.fields = [];
      const focused = document.activeElement?.dataset?.focus;
      this.root.replaceChildren(this.adders(), edit ? this.editor(edit) : this.empty(), app.shining.root);
      if (focused) this.root.querySelector(`[data-focus="${focused}"]`)?.focus({ preventScroll: true });
    }
    this.sync();
  }

  sync() {
    const light = this.app.edit()?.lights[0];
    if (light) this.fields.forEach((field) => field(light));
  }

  adders() {
    const tile = (kind, key) => el('button', {
      class: 'tile', title: `Add: ${KINDS[kind].name.toLowerCase()} (${key})`, 'data-add': kind, 'data-focus': `add-${kind}`,
      onclick: () => this.app.addLight(kind),
    }, icon(KINDS[kind].icon), el('span', {}, KINDS[kind].name));
    return el('section', { class: 'adders' }, el('h2', {}, 'Add light'),
      el('div', { class: 'tiles' }, ...Object.keys(KINDS).map((kind, i) => tile(kind, i + 1))));
  }

  empty() {
    return el('section', { class: 'empty' },
      el('p', {}, 'This is the scene in the light it was captured in.'),
      el('p', {}, 'Add a light and drag it around.'));
  }

  editor(edit) {
    const [light] = edit.lights;
    const title = el('div', { class: 'title' }, icon(KINDS[light.kind].icon), this.name(),
      el('button', {
        class: 'quiet', title: 'Remove this step', 'aria-label': 'Remove this step',
        onclick: () => this.app.removeStep(this.app.selected),
      }, icon('M3 4.500h10M6.500 4.500V3h3v1.500M4.500 4.500l.6 9h5.800l.6-9')));
    const body = light.kind === 'environment' ? this.environment(light) : this.local(light);
    const more = edit.lights.length > 1 ? [el('p', { class: 'note' }, `and ${edit.lights.length - 1} more in this step`)] : [];
    return el('section', { class: 'editor' }, title, this.modes(edit), ...body, ...more);
  }

  // What the step is called. An empty name is the usual one again.
  name() {
    const { app } = this;
    const node = app.selected;
    const shown = () => app.history.name(node);
    const input = el('input', {
      type: 'text', class: 'name', maxlength: 60, autocomplete: 'off', spellcheck: 'false', enterkeyhint: 'done',
      'aria-label': 'Name of this step', title: 'Rename', 'data-focus': 'name',
      onfocus: () => input.select(),
      onblur: () => {
        const name = input.value.trim();
        if (app.selected !== node || !app.edit() || name === shown()) input.value = shown();
        else app.rename(name);
      },
      onkeydown: (event) => {
        if (event.key === 'Escape') input.value = shown();
        if (event.key === 'Enter' || event.key === 'Escape') input.blur();
      },
    });
    this.fields.push(() => {
      if (document.activeElement !== input) input.value = shown();
    });
    return el('h2', {}, input);
  }

  // Modes the model was not trained for are shown, and say why they are off.
  modes(edit) {
    const group = el('div', { class: 'segments', role: 'radiogroup', 'aria-label': 'What this step does' });
    for (const { mode, available, reason } of this.app.info.modes) {
      const [name, what] = MODES[mode];
      group.append(el('button', {
        role: 'radio', 'aria-checked': String(edit.mode === mode), 'aria-disabled': String(!available),
        title: available ? what : `${what}. ${reason}`, 'data-focus': `mode-${mode}`, 'data-mode': mode,
        'aria-label': available ? name : `${name}, not available: ${reason}`,
        onclick: () => {
          if (!available) this.app.toast(`${name}: ${reason}`);
          else if (edit.mode !== mode) this.app.setMode(mode);
        },
      }, name));
    }
    return group;
  }

  // `usual`: where a double-click puts it. The number beside it can be typed too, beyond the slider's ends as far as `check` lets it.
  slider({ name, min, max, log = false, usual = null, unit, digits, read, write, check }) {
    const to = (v) => (log ? Math.log(v / min) / Math.log(max / min) : (v - min) / (max - min));
    const from = (t) => (log ? min * (max / min) ** t : min + t * (max - min));
    const typed = number(this.app, { name, unit, digits, read, write, check });
    const input = el('input', {
      type: 'range', min: 0, max: 1, step: 0.001, 'aria-label': name, 'data-focus': `field-${name}`,
      oninput: () => this.app.change(write(from(+input.value), this.app.edit().lights[0])),
      onchange: () => this.app.commit(),
      ondblclick: usual === null ? null : () => this.app.change(write(usual, this.app.edit().lights[0]), true),
    });
    this.fields.push((light) => {
      const value = read(light);
      if (document.activeElement !== input || Math.abs(from(+input.value) - value) > 1e-3 * Math.abs(value)) {
        input.value = clamp(to(value), 0, 1);
      }
      input.style.setProperty('--at', `${clamp(to(value), 0, 1) * 100}%`);
      input.setAttribute('aria-valuetext', `${short(value, digits)} ${unit}`);
      typed.sync(light);
    });
    return el('div', { class: 'field' }, el('span', {}, name), typed.element, input, typed.message);
  }

  local(light) {
    const { app } = this;
    if (light.kind === 'sun') return this.sun();
    const { scale } = app.toModel;
    const bright = scale ** 2 * luminance(app.session.exposure);
    const parts = [
      this.slider({
        name: 'Power', min: 10 / bright, max: 5000 / bright, log: true, unit: 'W',
        read: (l) => l.power, write: (power) => ({ power: +power.toPrecision(6) }), check: within(0.001, 1e12, 'W'),
      }),
      this.color(),
      this.slider({
        name: 'Distance', min: 1.2, max: 8, log: true, unit: 'radii', digits: 3,
        read: (l) => length(app.toModel.point(l.position)),
        write: (r, l) => ({ position: app.toModel.inverse(mul(unit(app.toModel.point(l.position)), r)) }),
        check: within(NEAREST, FARTHEST, 'radii'),
      }),
    ];
    if (light.kind === 'area') {
      parts.push(this.slider({
        name: 'Size', min: 0.1 / scale, max: 4 / scale, log: true, unit: 'm',
        read: (l) => l.size, write: (size) => ({ size: +size.toPrecision(6) }), check: above(0, 'm'),
      }));
    }
    if (light.kind === 'spot') {
      parts.push(this.slider({
        name: 'Cone', min: 2, max: 120, log: true, unit: '°', digits: 3,
        read: (l) => l.angle, write: (angle) => ({ angle: +angle.toPrecision(4) }), check: within(1, 180, '°'),
      }), this.slider({
        name: 'Soft edge', min: 0, max: 100, unit: '%', digits: 3, usual: 15,
        read: (l) => 100 * l.blend, write: (share) => ({ blend: +(share / 100).toPrecision(4) }), check: within(0, 100, '%'),
      }));
    }
    parts.push(this.place(), this.vector('Position', 'position', (p) => this.outside(p)));
    if (light.target) {
      parts.push(this.vector('Target', 'target', (p, l) => (length(sub(p, l.position)) * scale > 1e-3 ? null : 'expected another place than the light’s own')), el('button', {
        class: 'wide', onclick: () => app.change({ target: app.toModel.inverse([0, 0, 0]) }, true),
      }, 'Aim at the centre'));
    }
    return parts;
  }

  sun() {
    const bright = luminance(this.app.session.exposure);
    return [
      this.slider({
        name: 'Strength', min: 0.05 / bright, max: 30 / bright, log: true, unit: 'W/m²', digits: 3,
        read: (l) => l.strength, write: (v) => ({ strength: +v.toPrecision(6) }), check: within(1e-6, 1e12, 'W/m²'),
      }),
      this.color(),
      this.slider({
        name: 'Disc', min: 0.1, max: 60, log: true, usual: 0.526, unit: '°', digits: 3,
        read: (l) => l.angle, write: (angle) => ({ angle: +angle.toPrecision(4) }), check: within(0, 180, '°'),
      }),
      this.place(),
    ];
  }

  vector(name, field, check) {
    const { element, sync } = vector(this.app, { name, field, check });
    this.fields.push(sync);
    return element;
  }

  // Lights stand outside the scene's ball.
  outside(position) {
    const { toModel } = this.app;
    const r = length(toModel.point(position));
    if (r >= NEAREST && r <= FARTHEST) return null;
    const centre = toModel.inverse([0, 0, 0]).map((v) => short(Math.abs(v) * toModel.scale < 1e-5 ? 0 : v, 3)).join(', ');
    return { expected: `expected a place ${NEAREST} to ${FARTHEST} radii from the scene’s centre (${centre})`, found: `one at ${short(r, 3)}` };
  }

  color() {
    const { app } = this;
    const swatch = el('input', {
      type: 'color', 'aria-label': 'Colour', 'data-focus': 'field-colour',
      oninput: () => app.change({ color: fromHex(swatch.value) }),
      onchange: () => app.commit(),
    });
    const kelvin = el('input', {
      type: 'range', class: 'kelvin', min: 1800, max: 12000, step: 50, value: 6500, 'aria-label': 'Colour temperature', 'data-focus': 'field-kelvin',
      oninput: () => app.change({ color: blackBody(+kelvin.value) }),
      onchange: () => app.commit(),
    });
    this.fields.push((light) => {
      if (document.activeElement !== swatch) swatch.value = toHex(light.color);
      if (document.activeElement === kelvin) return;
      // The nearest temperature, by the ratio of red to blue.
      const wanted = Math.log((light.color[0] + 1e-3) / (light.color[2] + 1e-3));
      let best = [Infinity, 6500];
      for (let k = 1800; k <= 12000; k += 100) {
        const [r, , b] = blackBody(k);
        const off = Math.abs(Math.log((r + 1e-3) / (b + 1e-3)) - wanted);
        if (off < best[0]) best = [off, k];
      }
      [, kelvin.value] = best;
    });
    return el('div', { class: 'field colour' }, el('span', {}, 'Colour'), swatch, kelvin);
  }

  // Where the light is, as seen from above and from the side: for fingers, and for those who do not drag in 3D.
  place() {
    const { app } = this;
    const axis = (name, min, max, pick, put, check) => this.slider({
      name, min, max, unit: '°', digits: 3, check,
      read: (l) => (pick(spherical(placeOf(l, app.toModel))) * 180) / Math.PI,
      write: (v, l) => {
        const s = spherical(placeOf(l, app.toModel));
        return movedTo(l, cartesian({ ...s, ...put((v * Math.PI) / 180) }), app.toModel);
      },
    });
    return el('div', { class: 'pair' },
      axis('Around', -180, 180, (s) => s.azimuth, (azimuth) => ({ azimuth }), within(-360, 360, '°')),
      axis('Height', -30, 88, (s) => s.elevation, (elevation) => ({ elevation }), within(-89, 89, '°')));
  }

  environment(light) {
    const { app } = this;
    const strip = el('div', {
      class: 'panorama', role: 'slider', tabindex: '0', 'aria-label': 'Rotation of the environment',
      'aria-valuemin': -180, 'aria-valuemax': 180, title: 'Drag to rotate', 'data-focus': 'field-rotation',
    });
    const rotate = (by, keep) => {
      const light = app.edit().lights[0];
      app.change({ rotate: +(((light.rotate + by + 540) % 360 + 360) % 360 - 180).toFixed(1) }, keep);
    };
    strip.addEventListener('pointerdown', (event) => strip.setPointerCapture(event.pointerId));
    strip.addEventListener('pointermove', (event) => {
      if (strip.hasPointerCapture(event.pointerId) && event.movementX) {
        rotate((-360 * event.movementX) / strip.clientWidth, false);
      }
    });
    strip.addEventListener('pointerup', () => app.commit());
    strip.addEventListener('keydown', (event) => {
      const by = { ArrowLeft: 3, ArrowRight: -3 }[event.key];
      if (!by) return;
      event.preventDefault();
      rotate(event.shiftKey ? 5 * by : by, false);
      clearTimeout(this.later);
      this.later = setTimeout(() => app.commit(), 350);
    });
    const grid = el('div', { class: 'maps', role: 'radiogroup', 'aria-label': 'Environment map' });
    for (const map of app.maps) {
      grid.append(el('button', {
        role: 'radio', class: 'map', title: map.name, 'aria-label': map.name, 'data-map': map.id, 'data-focus': `map-${map.id}`,
        onclick: () => app.change({ map: map.id, strength: natural(map, app) }, true),
      }, el('img', { src: `/api/maps/${map.id}/preview`, alt: '', loading: 'lazy' }), el('span', {}, map.name)));
    }
    const file = el('input', { type: 'file', accept: '.hdr,.exr,.jpg,.jpeg,.png', hidden: true, onchange: () => this.addMaps([...file.files]) });
    grid.append(el('button', { class: 'map more', title: 'Add a .hdr or .exr file, or a .jpg or .png panorama', onclick: () => file.click() },
      icon('M8 3v10M3 8h10'), el('span', {}, 'Your own')), file);
    this.fields.push((light) => {
      strip.style.backgroundImage = `url(/api/maps/${light.map}/preview)`;
      strip.style.backgroundPositionX = `${(-light.rotate / 360) * strip.clientWidth}px`;
      strip.setAttribute('aria-valuenow', Math.round(light.rotate));
      strip.setAttribute('aria-valuetext', `${Math.round(light.rotate)} degrees`);
      grid.querySelectorAll('.map[data-map]').forEach((b) => b.setAttribute('aria-checked', String(b.dataset.map === light.map)));
    });
    const usual = natural(app.map(light.map) ?? app.maps[0], app);
    const strength = this.slider({
      name: 'Strength', min: usual / 30, max: 30 * usual, log: true, usual, unit: '×', digits: 3,
      read: (l) => l.strength, write: (v) => ({ strength: +v.toPrecision(6) }), check: above(0, '×'),
    });
    const rotation = number(app, {
      name: 'Rotation', unit: '°', read: (l) => l.rotate, check: within(-360, 360, '°'),
      write: (v) => ({ rotate: +(((v + 540) % 360 + 360) % 360 - 180).toFixed(3) }),
    });
    this.fields.push(rotation.sync);
    const turned = el('div', { class: 'field' }, el('span', {}, 'Rotation'), rotation.element, rotation.message);
    return [strip, turned, strength, grid];
  }

  // Files from the picker or dropped on the page; the last one is put to use.
  async addMaps(files) {
    const { app } = this;
    for (const file of files) {
      try {
        const name = file.name.replace(/\.[^.]*$/, '');
        const { id, warnings } = await post(`/api/maps?name=${encodeURIComponent(name)}`, file);
        warnings.forEach((text) => app.toast(`${name}: ${text}.`));
        await app.loadMaps();
        app.fine('map');
        const values = { map: id, strength: natural(app.map(id), app) };
        if (app.edit()?.lights[0].kind === 'environment') app.change(values, true);
        else await app.addLight('environment', values);
      } catch (e) {
        app.failed('map', e.message);
      }
    }
  }
}
