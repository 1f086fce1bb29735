// The environment that lights the scene, as the eye sees it behind the scene.

import { View, add, mul } from './space.js';

// Pixels of the page that share one look-up; what stands behind is out of focus anyway.
const COARSE = 6;
// Maps are read at this width: four look-ups to a degree.
const WIDTH = 1440;

export class Backdrop {
  constructor(app) {
    this.app = app;
    this.canvas = document.createElement('canvas');
    this.context = this.canvas.getContext('2d');
    this.maps = new Map();
  }

  // The last environment that is on and seen.
  light() {
    const { shining } = this.app;
    const entries = shining.entries();
    const seen = shining.seen(entries);
    return entries.filter((e) => e.light?.kind === 'environment' && seen.has(e.key)).at(-1)?.light ?? null;
  }

  // The pixels of a map's preview; null until they are there, when the stage is drawn again.
  pixels(id) {
    if (!this.maps.has(id)) {
      this.maps.set(id, null);
      const image = new Image();
      image.onload = () => {
        const [width, height] = [WIDTH, WIDTH / 2];
        const canvas = Object.assign(document.createElement('canvas'), { width, height });
        const context = canvas.getContext('2d', { willReadFrequently: true });
        context.imageSmoothingQuality = 'high';
        context.drawImage(image, 0, 0, width, height);
        this.maps.set(id, context.getImageData(0, 0, width, height));
        this.app.stage.draw();
      };
      image.onerror = () => this.maps.delete(id);
      image.src = `/api/maps/${id}/preview`;
    }
    return this.maps.get(id);
  }

  // What is behind a picture in `square`, from `left` to `right` of a stage of this height, as a small canvas; null without an
  // environment.
  behind(camera, { cx, cy, side }, left, right, height) {
    const light = this.light();
    const map = light && this.pixels(light.map);
    if (!map) return null;
    const view = new View(camera, cx, cy, side);
    const { toModel } = this.app;
    // The camera's axes in the world, turned back as the map is turned.
    const turn = (-light.rotate * Math.PI) / 180;
    const [s, c] = [Math.sin(turn), Math.cos(turn)];
    const axis = (v) => {
      const [x, y, z] = toModel.back(v);
      return [c * x - s * y, s * x + c * y, z];
    };
    const [ahead, across, down] = [axis(view.forward), mul(axis(view.right), 1 / view.focal), mul(axis(view.down), 1 / view.focal)];
    const [w, h] = [Math.max(Math.ceil((right - left) / COARSE), 1), Math.ceil(height / COARSE)];
    const { canvas, context } = this;
    Object.assign(canvas, { width: w, height: h });
    const out = context.createImageData(w, h);
    const from = new Uint32Array(map.data.buffer);
    const to = new Uint32Array(out.data.buffer);
    for (let j = 0; j < h; j += 1) {
      const row = add(ahead, mul(down, (j + 0.5) * COARSE - cy));
      for (let i = 0; i < w; i += 1) {
        const t = left + (i + 0.5) * COARSE - cx;
        const x = row[0] + t * across[0];
        const y = row[1] + t * across[1];
        const z = row[2] + t * across[2];
        const u = 0.5 - Math.atan2(y, x) / (2 * Math.PI);
        const v = Math.acos(z / Math.sqrt(x * x + y * y + z * z)) / Math.PI;
        const column = Math.min(Math.floor(u * map.width), map.width - 1);
        const line = Math.min(Math.floor(v * map.height), map.height - 1);
        to[j * w + i] = from[line * map.width + column];
      }
    }
    context.putImageData(out, 0, 0);
    return canvas;
  }
}
