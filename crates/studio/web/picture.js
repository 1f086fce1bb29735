// Draws frames: small pictures enlarged smoothly, in a pool of light on the dark stage.

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

// An RGB picture of w x h enlarged to `size` pixels square, as ImageData.
export function enlarge(rgb, w, h, size) {
  const across = taps(w, size);
  const rows = new Float32Array(h * size * 3);
  for (let y = 0; y < h; y += 1) {
    for (let x = 0; x < size; x += 1) {
      const [at, k] = across[x];
      for (let c = 0; c < 3; c += 1) {
        const i = y * w * 3 + c;
        rows[(y * size + x) * 3 + c] = k[0] * rgb[i + at[0] * 3] + k[1] * rgb[i + at[1] * 3]
          + k[2] * rgb[i + at[2] * 3] + k[3] * rgb[i + at[3] * 3];
      }
    }
  }
  const down = taps(h, size);
  const out = new ImageData(size, size);
  const line = size * 3;
  for (let y = 0; y < size; y += 1) {
    const [at, k] = down[y];
    const [a, b, c, d] = at.map((row) => row * line);
    let o = y * size * 4;
    for (let x = 0; x < line; x += 3) {
      for (let j = x; j < x + 3; j += 1) {
        out.data[o] = k[0] * rows[a + j] + k[1] * rows[b + j] + k[2] * rows[c + j] + k[3] * rows[d + j];
        o += 1;
      }
      out.data[o] = 255;
      o += 1;
    }
  }
  return out;
}

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d', { alpha: false });
    this.panes = [];
    // Pools of light are costly to paint and change only with the layout and the camera's distance.
    this.pools = new Map();
  }

  // Panes are kept as small canvases, already smooth.
  show(header, panes) {
    const size = clamp(header.width * 8, 256, 512);
    panes.forEach((rgb, i) => {
      const pane = this.panes[i] ?? document.createElement('canvas');
      if (pane.width !== size || pane.height !== size) {
        pane.width = size;
        pane.height = size;
      }
      pane.getContext('2d').putImageData(enlarge(rgb, header.width, header.height, size), 0, 0);
      this.panes[i] = pane;
    });
    this.panes.length = panes.length;
  }

  // Places the panes: `layout` is 'one', 'split' or 'side', `squares` where each picture goes, `split` in [0, 1].
  draw({ width, height, layout, squares, split }) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { canvas, context: c } = this;
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) {
      canvas.width = w;
      canvas.height = h;
    }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.imageSmoothingQuality = 'high';
    c.fillStyle = '#0d0f13';
    c.fillRect(0, 0, width, height);
    const pane = (image, square, [left, right], area = [0, width]) => {
      if (!image) return;
      c.save();
      c.beginPath();
      c.rect(left, 0, right - left, height);
      c.clip();
      c.fillStyle = '#fff';
      c.fillRect(left, 0, right - left, height);
      c.drawImage(image, square.cx - square.side / 2, square.cy - square.side / 2, square.side, square.side);
      this.shade(square, area, height, ratio);
      c.restore();
    };
    const [now, other] = this.panes;
    if (layout === 'side' && other) {
      pane(other, squares[0], [0, width / 2], [0, width / 2]);
      pane(now, squares[1], [width / 2, width], [width / 2, width]);
    } else if (layout === 'split' && other) {
      const x = split * width;
      pane(other, squares[0], [0, x]);
      pane(now, squares[0], [x, width]);
    } else {
      pane(now, squares[0], [0, width]);
    }
  }

  // A pool of light around the scene that fades into the dark page. Where a near camera lets the scene reach the
  // edges of its square, the pool ends before they show.
  shade(square, [left, right], height, ratio) {
    const key = JSON.stringify([square, left, right, height, ratio]);
    let pool = this.pools.get(key);
    if (!pool) {
      if (this.pools.size > 3) this.pools.clear();
      pool = document.createElement('canvas');
      pool.width = Math.ceil((right - left) * ratio);
      pool.height = Math.ceil(height * ratio);
      const c = pool.getContext('2d');
      c.scale(ratio, ratio);
      c.translate(-left, 0);
      c.fillStyle = this.gradient(c, square);
      c.fillRect(left, 0, right - left, height);
      this.pools.set(key, pool);
    }
    this.context.drawImage(pool, left, 0, pool.width / ratio, pool.height / ratio);
  }

  gradient(c, { cx, cy, side, reach }) {
    const r = side / 2;
    const near = clamp((reach / r - 0.9) / 0.3, 0, 1);
    const start = r * (0.84 - 0.16 * near);
    const end = r * (1.42 - 0.44 * near);
    const g = c.createRadialGradient(cx, cy, 0, cx, cy, end * 1.5);
    const steps = 24;
    g.addColorStop(0, 'rgba(13, 15, 19, 0)');
    for (let i = 0; i <= steps; i += 1) {
      const t = i / steps;
      // Dark falls quickly at first, as brightness is seen, then lingers.
      const alpha = 1 - (1 - t) ** 2 * (1 + 2 * t) * (1 - 0.55 * t);
      g.addColorStop((start + (end - start) * t) / (end * 1.5), `rgba(13, 15, 19, ${(0.955 * alpha).toFixed(3)})`);
    }
    g.addColorStop(1, 'rgba(13, 15, 19, 1)');
    return g;
  }
}
