// The lights that are on at the shown step. Each can be hidden or seen alone: that is a look, no step knows of it.

import { el, icon } from './dom.js';
import { css } from './gizmo.js';

const EYE = 'M1.500 8C3 5 5.200 3.500 8 3.500S13 5 14.500 8C13 11 10.800 12.500 8 12.500S3 11 1.500 8M8 6.200a1.800 1.800 0 1 0 0 3.600 1.800 1.800 0 1 0 0-3.600';
const CLOSED = `${EYE}M3 13 13 3`;
// Lights of one edit, as the server takes them.
const MOST = 16;

export class Shining {
  constructor(app, chip) {
    this.app = app;
    this.chip = chip;
    this.root = el('section', { class: 'shining', 'aria-label': 'Lights at this step' });
    chip.onclick = () => this.all();
    this.reset();
  }

  reset() {
    this.hidden = new Set();
    this.solo = null;
  }

  // What is on after a step: the captured light until a step replaces it, and every light since; a removal takes the
  // light that it names, or some of the captured light (`taken`).
  entries(id = this.app.head) {
    const { app } = this;
    let on = [{ key: 'captured', node: 0, light: null }];
    for (const node of app.path(id)) {
      const edit = app.draft?.node === node.id ? app.draft.edit : node.edit;
      if (edit?.mode === 'set') on = [];
      edit?.lights.forEach((light, k) => {
        const entry = { key: `${node.id}.${k}`, node: node.id, light };
        if (edit.mode !== 'remove') {
          on.push(entry);
          return;
        }
        const same = on.findIndex((e) => !e.taken && JSON.stringify(e.light) === JSON.stringify(light));
        if (same >= 0) on.splice(same, 1);
        else on.push({ ...entry, taken: true });
      });
    }
    return on;
  }

  name(entry) {
    return entry.light ? this.app.history.name(entry.node) : 'Captured light';
  }

  // The keys of what is seen. A look that would leave nothing of this step shows all of it.
  seen(entries = this.entries()) {
    const lights = entries.filter((e) => !e.taken).map((e) => e.key);
    const kept = lights.filter((key) => (lights.includes(this.solo) ? key === this.solo : !this.hidden.has(key)));
    return new Set(kept.length ? kept : lights);
  }

  shows(key) {
    const entries = this.entries();
    return !entries.some((e) => e.key === key) || this.seen(entries).has(key);
  }

  // The request that shows no more than what is seen, from the capture on; null if that is all.
  request() {
    const entries = this.entries();
    const seen = this.seen(entries);
    if (entries.every((e) => e.taken || seen.has(e.key))) return null;
    const captured = seen.has('captured');
    const lights = entries.filter((e) => e.light && seen.has(e.key)).map((e) => e.light);
    const draft = [];
    for (let i = 0; i < lights.length; i += MOST) {
      draft.push({ mode: captured || i ? 'add' : 'set', lights: lights.slice(i, i + MOST) });
    }
    const taken = entries.filter((e) => e.taken).map((e) => ({ mode: 'remove', lights: [e.light] }));
    return { node: 0, draft: captured ? [...draft, ...taken] : draft };
  }

  all() {
    this.reset();
    this.app.changed();
  }

  toggle(key) {
    const entries = this.entries();
    const seen = this.seen(entries);
    if (!seen.delete(key)) seen.add(key);
    if (!seen.size) return;
    this.solo = null;
    for (const e of entries) {
      if (seen.has(e.key)) this.hidden.delete(e.key);
      else this.hidden.add(e.key);
    }
    this.app.changed();
  }

  alone(key) {
    this.solo = this.solo === key ? null : key;
    this.app.changed();
  }

  render() {
    const { app } = this;
    const entries = this.entries();
    const seen = this.seen(entries);
    const lights = entries.filter((e) => !e.taken);
    const part = seen.size < lights.length;
    this.chip.hidden = !part;
    this.chip.textContent = `${seen.size} of ${lights.length} lights shown · Show all`;
    const key = JSON.stringify([app.head, app.selected, app.maps.length, [...seen], entries.map((e) => [e.key, e.taken, e.light?.color, this.name(e)]), this.solo]);
    if (key === this.key) return;
    this.key = key;
    const focused = this.root.contains(document.activeElement) ? document.activeElement.dataset.focus : null;
    const able = ['set', 'add'].every((mode) => app.info.modes.find((m) => m.mode === mode)?.available);
    this.root.hidden = app.head === 0;
    this.root.replaceChildren(el('h2', {}, 'On at this step'),
      ...entries.map((e) => this.row(e, seen, able && lights.length > 1)),
      ...(part ? [el('p', { class: 'note' }, 'A look, not an edit: steps and exports keep every light.')] : []));
    if (focused) this.root.querySelector(`[data-focus="${focused}"]`)?.focus({ preventScroll: true });
  }

  row(entry, seen, able) {
    const { app } = this;
    const name = this.name(entry);
    const dot = el('i', { class: 'dot' });
    const { light, key } = entry;
    dot.style.background = light?.color ? css(light.color) : light ? 'linear-gradient(135deg,#7db4ff,#ffd9a0)' : 'linear-gradient(135deg,#ffffff,#9aa2b1)';
    const shown = seen.has(key);
    const select = el('button', {
      class: 'row', 'data-focus': `row-${key}`, 'aria-current': light && entry.node === app.selected ? 'true' : false,
      title: light ? `Edit ${name}` : 'The light that the scene was captured in', onclick: () => light && app.select(entry.node),
    }, dot, el('span', {}, entry.taken ? `− ${name}` : name));
    if (!able || entry.taken) return el('div', { class: 'lit' }, select);
    const only = shown && seen.size === 1;
    const eye = el('button', {
      class: 'quiet eye', 'data-focus': `eye-${key}`, 'data-eye': key, 'aria-pressed': String(shown), disabled: only,
      title: only ? 'One light stays' : shown ? 'Hide' : 'Show', 'aria-label': `${shown ? 'Hide' : 'Show'} ${name}`, onclick: () => this.toggle(key),
    }, icon(shown ? EYE : CLOSED));
    const alone = el('button', {
      class: 'chip', 'data-focus': `solo-${key}`, 'data-solo': key, 'aria-pressed': String(this.solo === key), 'aria-label': `${name} alone`,
      title: 'See this light alone', onclick: () => this.alone(key),
    }, 'Solo');
    return el('div', { class: shown ? 'lit' : 'lit off' }, eye, select, alone);
  }
}
