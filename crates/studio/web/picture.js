// Draws frames: small pictures enlarged smoothly, over the background that a person chooses.

import { clamp } from './space.js';

// Catmull-Rom weights of the four neighbours.
function weights(t) {
  const t2 = t * t;
  const t3 = t2 * t;
  return [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1, -1.5 * t3 + 2 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2];
}

// For each of `size` outputs: the four source indices and weights.
function taps(source, size) {
  const all = [];
  for (let i = 0; i < size; i += 1) {
    const x = ((i + 0.5) * source) / size - 0.5;
    const first = Math.floor(x);
    const at = [-1, 0, 1, 2].map((k) => clamp(first + k, 0, source - 1));
    all.push([at, weights(x - first)]);
  }
  return all;
}

// A picture of w x h, R G B times alpha and alpha of each pixel, enlarged to `size` pixels square: ImageData, whose colours are
// not multiplied with alpha.
export function enlarge(rgba, w, h, size) {
  const across = taps(w, size);
  const rows = new Float32Array(h * size * 4);
  for (let y = 0; y < h; y += 1) {
    for (let x = 0; x < size; x += 1) {
      const [[a, b, c, d], [k, l, m, n]] = across[x];
      const o = (y * size + x) * 4;
      for (let j = 0; j < 4; j += 1) {
        const i = y * w * 4 + j;
        rows[o + j] = k * rgba[i + a * 4] + l * rgba[i + b * 4] + m * rgba[i + c * 4] + n * rgba[i + d * 4];
      }
    }
  }
  const down = taps(h, size);
  const out = new ImageData(size, size);
  const { data } = out;
  const line = size * 4;
  for (let y = 0; y < size; y += 1) {
    const [at, [k, l, m, n]] = down[y];
    const [a, b, c, d] = at.map((row) => row * line);
    for (let x = 0; x < line; x += 4) {
      const e = x + 3;
      const alpha = k * rows[a + e] + l * rows[b + e] + m * rows[c + e] + n * rows[d + e];
      // Most of a picture is empty.
      if (alpha < 0.5) continue;
      const o = y * line + x;
      const straight = alpha < 255 ? 255 / alpha : 1;
      for (let j = 0; j < 3; j += 1) {
        const i = x + j;
        data[o + j] = straight * (k * rows[a + i] + l * rows[b + i] + m * rows[c + i] + n * rows[d + i]);
      }
      data[o + 3] = alpha;
    }
  }
  return out;
}

// What stands behind the scene: a colour, two of a checkerboard, or the environment, and a colour where there is none.
export const BACKGROUNDS = { dark: ['#14171d'], light: ['#f4f4f2'], checkerboard: ['#b9bcc2', '#9a9ea6'], environment: ['#14171d'] };
// Side of a checkerboard's fields in pixels of the page.
const FIELD = 14;

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d', { alpha: false });
    this.panes = [];
  }

  // Panes are kept as small canvases, already smooth.
  show(header, panes) {
    const size = clamp(header.width * 8, 256, 512);
    panes.forEach((rgba, i) => {
      const pane = this.panes[i] ?? document.createElement('canvas');
      if (pane.width !== size || pane.height !== size) {
        pane.width = size;
        pane.height = size;
      }
      pane.getContext('2d').putImageData(enlarge(rgba, header.width, header.height, size), 0, 0);
      this.panes[i] = pane;
    });
    this.panes.length = panes.length;
  }

  // Places the panes: `layout` is 'one', 'split' or 'side', `squares` where each picture goes, `split` in [0, 1],
  // `background` one of BACKGROUNDS, `behind` makes what stands in front of that from a square, left and right, and `photograph`
  // what stands in the place of the other pane.
  draw({ width, height, layout, squares, split, background, behind, photograph }) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { canvas, context: c } = this;
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) {
      canvas.width = w;
      canvas.height = h;
    }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.imageSmoothingQuality = 'high';
    const [ground, fields] = BACKGROUNDS[background] ?? BACKGROUNDS.dark;
    c.fillStyle = ground;
    c.fillRect(0, 0, width, height);
    if (fields) {
      c.fillStyle = fields;
      for (let y = 0; y * FIELD < height; y += 1) {
        for (let x = y % 2; x * FIELD < width; x += 2) c.fillRect(x * FIELD, y * FIELD, FIELD, FIELD);
      }
    }
    const pane = (image, square, [left, right]) => {
      if (!image) return;
      c.save();
      c.beginPath();
      c.rect(left, 0, right - left, height);
      c.clip();
      if (image === photograph) {
        // Photographs are cut out over white, which would end at their edges.
        c.fillStyle = '#fff';
        c.fillRect(left, 0, right - left, height);
      } else {
        const far = behind?.(square, left, right);
        if (far) c.drawImage(far, left, 0, right - left, height);
      }
      c.drawImage(image, square.cx - square.side / 2, square.cy - square.side / 2, square.side, square.side);
      c.restore();
    };
    const now = this.panes[0];
    const other = photograph ?? this.panes[1];
    if (layout === 'side' && other) {
      pane(other, squares[0], [0, width / 2]);
      pane(now, squares[1], [width / 2, width]);
    } else if (layout === 'split' && other) {
      const x = split * width;
      pane(other, squares[0], [0, x]);
      pane(now, squares[0], [x, width]);
    } else {
      pane(now, squares[0], [0, width]);
    }
  }
}
