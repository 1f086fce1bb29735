// The keys, for a dialog.

import { el } from './dom.js';

const KEYS = [
  ['Light', [['1', 'add an environment'], ['2', 'add a point light'], ['3', 'add an area light'],
    ['4', 'add a spot light'], ['5', 'add a sun'],
    ['Arrows', 'move the handle or slider that has the focus'], ['Enter', 'apply a number or a name'], ['Esc', 'take back what was typed']]],
  ['Steps', [['Ctrl Z', 'undo'], ['Ctrl Shift Z', 'redo'], ['Delete', 'remove the step'], ['Arrows', 'walk the history']]],
  ['Look', [['Arrows', 'orbit, with the picture in focus'], ['+ −', 'zoom'], ['Home', 'back to the first view'], ['B', 'next background'],
    ['C', 'compare with the step before'], ['P', 'compare with the nearest photograph'], ['Esc', 'end the comparison']]],
  ['Page', [['O', 'open'], ['E', 'export'], ['?', 'these keys']]],
];

export function keys() {
  const row = ([key, what]) => el('div', {}, el('dt', {}, ...key.split(' ').map((k) => el('kbd', {}, k))), el('dd', {}, what));
  return el('div', { class: 'keys' },
    ...KEYS.map(([title, rows]) => el('section', {}, el('h2', {}, title), el('dl', {}, ...rows.map(row)))));
}
