// Geometry: world and model space, the orbit camera, and where things appear on the stage.
// Model space is where the scene fills the unit ball; z is up.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const mul = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.hypot(...a);
export const unit = (a) => mul(a, 1 / (length(a) || 1));
export const clamp = (v, low, high) => Math.min(high, Math.max(low, v));

// A similarity as the server writes it: x -> scale * R x + t, R as nine numbers, column by column.
export class Similarity {
  constructor({ scale, rotation, translation }) {
    this.scale = scale;
    this.columns = [rotation.slice(0, 3), rotation.slice(3, 6), rotation.slice(6, 9)];
    this.translation = translation;
  }

  turn(x) {
    const [a, b, c] = this.columns;
    return add(add(mul(a, x[0]), mul(b, x[1])), mul(c, x[2]));
  }

  point(x) {
    return add(mul(this.turn(x), this.scale), this.translation);
  }

  // A direction of model space in the world.
  back(d) {
    return this.columns.map((column) => dot(column, d));
  }

  inverse(y) {
    return mul(this.back(sub(y, this.translation)), 1 / this.scale);
  }
}

// Lights stand three to five radii away, mostly outside the picture or behind the camera. To be seen and held they
// are drawn in their true direction on a dome close to the scene, farther ones farther out.
const REACH = 1.62;
const NEAR = 0.56;
export const shown = (radius) => REACH - NEAR / Math.max(radius, 1.02);
export const onDome = (p) => mul(unit(p), shown(length(p)));

export class View {
  // `camera` as the server takes it; the picture is a square of `side` pixels around (cx, cy).
  constructor(camera, cx, cy, side) {
    const { azimuth: a, elevation: e, distance: d } = camera;
    this.eye = mul([Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)], d);
    this.forward = unit(mul(this.eye, -1));
    const up = Math.abs(this.forward[2]) > 0.999 ? [0, 1, 0] : [0, 0, 1];
    this.right = unit(cross(this.forward, up));
    this.down = cross(this.forward, this.right);
    this.focal = (0.5 * side) / Math.tan(0.5 * camera.fov);
    Object.assign(this, { cx, cy, side });
  }

  // Stage position of a model-space point, and its depth.
  project(p) {
    const v = sub(p, this.eye);
    const z = Math.max(dot(v, this.forward), 0.05);
    return {
      x: this.cx + (this.focal * dot(v, this.right)) / z,
      y: this.cy + (this.focal * dot(v, this.down)) / z,
      depth: dot(v, this.forward),
    };
  }

  ray(x, y) {
    const d = add(add(mul(this.right, (x - this.cx) / this.focal), mul(this.down, (y - this.cy) / this.focal)), this.forward);
    return unit(d);
  }

  // Whether a point is on the far side of the scene's centre.
  behind(p) {
    return dot(p, this.forward) > 0;
  }

  // The point of the sphere of `radius` below a stage position, on its near or far side; outside its outline, the
  // nearest point of the outline.
  onSphere(x, y, radius, far) {
    const d = this.ray(x, y);
    const b = dot(this.eye, d);
    const c = dot(this.eye, this.eye) - radius * radius;
    const q = b * b - c;
    if (q <= 0) return mul(unit(add(this.eye, mul(d, -b))), radius);
    const t = far || c < 0 ? -b + Math.sqrt(q) : -b - Math.sqrt(q);
    return add(this.eye, mul(d, t));
  }

  // The point below a stage position in the plane through `p` that faces the camera.
  onPlane(x, y, p) {
    const d = this.ray(x, y);
    const t = dot(sub(p, this.eye), this.forward) / dot(d, this.forward);
    return add(this.eye, mul(d, t));
  }
}

export const spherical = (p) => {
  const r = length(p);
  return { azimuth: Math.atan2(p[1], p[0]), elevation: Math.asin(clamp(p[2] / (r || 1), -1, 1)), distance: r };
};

export const cartesian = ({ azimuth: a, elevation: e, distance: d }) =>
  mul([Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)], d);
