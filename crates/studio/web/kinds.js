// The kinds of light: what they are called, how they are drawn in lists, and where their handle is.

import { mul, unit } from './space.js';

// In the order of their keys, 1 to 5. `usual`: what one is called that has no name yet, with a number.
export const KINDS = {
  environment: { name: 'Environment', icon: 'M2 8a6 6 0 1 0 12 0A6 6 0 1 0 2 8M2 8h12M8 2c-4 4-4 8 0 12M8 2c4 4 4 8 0 12' },
  point: { name: 'Point light', usual: 'Point', icon: 'M8 5.200a2.800 2.800 0 1 0 0 5.600 2.800 2.800 0 1 0 0-5.600M8 1v1.500M8 13.500V15M1 8h1.500M13.500 8H15M3 3l1 1M12 12l1 1M3 13l1-1M12 4l1-1' },
  area: { name: 'Area light', usual: 'Area', icon: 'M3 4.500 10 2.500v8l-7 2zM10 5l4 1.500M10 8.500l3 2' },
  spot: { name: 'Spot light', usual: 'Spot', icon: 'M8 1.500 3 12.500M8 1.500l5 11M3 12.500a5 1.900 0 1 0 10 0 5 1.900 0 1 0-10 0' },
  sun: { name: 'Sun', usual: 'Sun', icon: 'M10.500 2a3.500 3.500 0 1 0 0 7 3.500 3.500 0 1 0 0-7M6.500 8.200 2 12.700M8.700 10.300l-3 3M5.200 5.800 2.500 8.500' },
};

// Suns have no place: their handle is on the outside of the dome on which lights are drawn.
const OUTERMOST = 12;

// Where a light's handle is, in model space; and what of a light changes if it is moved there.
export const placeOf = (light, toModel) => (light.from ? mul(unit(toModel.turn(light.from)), OUTERMOST) : toModel.point(light.position));
export const movedTo = (light, p, toModel) => (light.from ? { from: toModel.back(unit(p)) } : { position: toModel.inverse(p) });
