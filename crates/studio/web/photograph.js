// The photograph that was taken nearest to the present view, compared with the picture.

import { cartesian, dot } from './space.js';

const degrees = (radians) => Math.round((radians * 180) / Math.PI);

// Where a captured view was taken, in words.
export function place({ azimuth, elevation }) {
  const up = degrees(elevation);
  return `${degrees(azimuth)}° around, ${Math.abs(up)}° ${up < 0 ? 'below' : 'up'}`;
}

export class Photograph {
  constructor(app) {
    Object.assign(this, { app, shown: null });
  }

  // The captured view whose direction is nearest to a camera's; -1 if there is none.
  nearest(camera) {
    const from = ({ azimuth, elevation }) => cartesian({ azimuth, elevation, distance: 1 });
    const here = from(camera);
    let best = [-Infinity, -1];
    this.app.session.inputs.forEach((view, i) => {
      const near = dot(from(view.camera), here);
      if (near > best[0]) best = [near, i];
    });
    return best[1];
  }

  // A photograph shows the scene from one place only: the camera goes there first, and what moves it ends the comparison.
  async toggle() {
    const { app } = this;
    if (this.shown) {
      this.leave();
      return;
    }
    const { session } = app;
    const index = session ? this.nearest(app.stage.camera) : -1;
    if (index < 0) return;
    const view = session.inputs[index];
    const image = Object.assign(new Image(), { src: app.url(`inputs/${index}`) });
    const asked = {};
    this.asked = asked;
    try {
      await Promise.all([image.decode(), app.stage.glide(view.camera)]);
    } catch {
      app.failed('photograph', `The photograph ${view.name} cannot be shown.`);
      return;
    }
    app.fine('photograph');
    // Somebody may have gone on meanwhile.
    if (this.asked !== asked || app.session.id !== session.id) return;
    app.compare = null;
    this.shown = { name: view.name, image };
    app.changed();
  }

  leave() {
    this.asked = null;
    if (!this.shown) return;
    this.shown = null;
    this.app.changed();
  }
}
