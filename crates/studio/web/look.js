// How the picture is shown: what stands behind it, exposure and tone curve. None of it changes the scene's light.

import { BACKGROUNDS } from './picture.js';
import { clamp } from './space.js';

const KEY = 'lumi-look';
// Stops either way.
const STOPS = 4;

export class Look {
  constructor(app, root) {
    this.app = app;
    this.root = root;
    Object.assign(this, { background: 'dark', exposure: 0, tone: 'standard' });
    try {
      const { background } = JSON.parse(localStorage.getItem(KEY) ?? '{}');
      if (BACKGROUNDS[background]) this.background = background;
    } catch {
      // Somebody else's value.
    }
    this.build();
    this.render();
  }

  // What the server does of it.
  shown() {
    return { exposure: this.exposure, tone: this.tone };
  }

  build() {
    const button = (name, title, act) => {
      const made = document.createElement('button');
      made.className = `swatch ${name}`;
      made.title = title;
      made.setAttribute('aria-label', title);
      made.onclick = act;
      return made;
    };
    this.swatches = Object.keys(BACKGROUNDS).map((name) => {
      const made = button(name, `Background: ${name} (B)`, () => this.set({ background: name }));
      made.setAttribute('role', 'radio');
      return [name, made];
    });
    const group = document.createElement('div');
    group.className = 'swatches';
    group.setAttribute('role', 'radiogroup');
    group.setAttribute('aria-label', 'Background');
    group.append(...this.swatches.map(([, made]) => made));
    this.slider = Object.assign(document.createElement('input'), {
      type: 'range', min: -STOPS, max: STOPS, step: 0.1, id: 'exposure', title: 'Exposure in stops; double-click for 0',
    });
    this.slider.setAttribute('aria-label', 'Exposure in stops');
    this.slider.oninput = () => this.set({ exposure: Number(this.slider.value) }, true);
    this.slider.onchange = () => this.set({});
    this.slider.ondblclick = () => this.set({ exposure: 0 });
    this.value = document.createElement('output');
    this.curve = document.createElement('button');
    this.curve.id = 'tone';
    this.curve.className = 'chip';
    this.curve.title = 'Filmic: bright shades stay apart instead of turning white';
    this.curve.textContent = 'Filmic';
    this.curve.onclick = () => this.set({ tone: this.tone === 'filmic' ? 'standard' : 'filmic' });
    this.root.replaceChildren(group, this.slider, this.value, this.curve);
  }

  set(values, moving = false) {
    Object.assign(this, values);
    this.exposure = clamp(this.exposure, -STOPS, STOPS);
    localStorage.setItem(KEY, JSON.stringify({ background: this.background }));
    this.render();
    this.app.stage?.request(moving);
  }

  next() {
    const names = Object.keys(BACKGROUNDS);
    this.set({ background: names[(names.indexOf(this.background) + 1) % names.length] });
  }

  render() {
    for (const [name, made] of this.swatches) made.setAttribute('aria-checked', String(name === this.background));
    this.slider.value = this.exposure;
    this.slider.style.setProperty('--at', `${(50 * (this.exposure + STOPS)) / STOPS}%`);
    this.value.textContent = `${this.exposure > 0 ? '+' : ''}${this.exposure.toFixed(1)} EV`;
    this.curve.setAttribute('aria-pressed', String(this.tone === 'filmic'));
    document.getElementById('stage').dataset.background = this.background;
  }
}
