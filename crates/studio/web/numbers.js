// Numbers that are typed, with their unit: Enter or leaving the field applies, Escape takes back what was typed.

import { el } from './dom.js';

// As many digits as anybody reads, without zeros at the end.
export const short = (value, digits = 4) => String(+value.toPrecision(digits));

// What was typed as a number of units; the unit may be there too, with k for a thousand, and a comma for the point.
export function parse(text, unit) {
  const plain = text.trim().replace(',', '.').replace('−', '-');
  const [, number, suffix] = plain.match(/^([-+]?[\d.]+(?:e[-+]?\d+)?)\s*(.*)$/i) ?? [];
  const factor = { '': 1, [unit]: 1, [`k${unit}`]: 1000 }[suffix] ?? NaN;
  return Number(number) * factor;
}

// Values that a number may have, in words where it may not.
export const above = (least, unit) => (v) => (v > least ? null : `expected more than ${least} ${unit}`);
export const within = (low, high, unit) => (v) => (v >= low && v <= high ? null : `expected ${low} to ${high} ${unit}`);

// One field: the element, the line that says what is wrong, and `sync`, which shows a light's value. `read` and `write`
// go from a light to the value and from a value to what changes of the light; `check` says what was expected instead of a
// value, and what was found if that is not what was typed.
export function number(app, { name, unit, digits, label = name, read, write, check, message = wrongLine() }) {
  const node = app.selected;
  let shown = '';
  const said = (text) => {
    if (text) input.setAttribute('aria-invalid', 'true');
    else input.removeAttribute('aria-invalid');
    message.textContent = text ?? '';
    message.hidden = !text;
  };
  const apply = () => {
    // The field may go away because another light was selected.
    if (app.selected !== node || !app.edit()) return;
    const text = input.value.trim();
    const light = app.edit().lights[0];
    if (text === shown) {
      said(null);
      return;
    }
    const value = parse(text, unit);
    const wrong = Number.isFinite(value) ? check?.(value, light) : 'expected a number';
    if (wrong) {
      const { expected, found } = typeof wrong === 'string' ? { expected: wrong, found: `“${text}”` } : wrong;
      said(`${name}: ${expected}, found ${found}.`);
      return;
    }
    said(null);
    // What is shown from now on, also if it is the value that was there.
    shown = text;
    app.change(write(value, light), true);
  };
  const input = el('input', {
    type: 'text', inputmode: 'decimal', autocomplete: 'off', spellcheck: 'false', enterkeyhint: 'done',
    'aria-label': `${label} in ${unit}`, 'data-number': label, 'data-focus': `number-${label}`,
    onfocus: () => input.select(),
    onblur: apply,
    onkeydown: (event) => {
      if (event.key === 'Enter') {
        apply();
        input.select();
      } else if (event.key === 'Escape') {
        input.value = shown;
        said(null);
        input.blur();
      } else {
        return;
      }
      event.preventDefault();
    },
  });
  const sync = (light) => {
    const now = short(read(light), digits);
    // What somebody is typing stays, and so does what was refused until the value changes.
    const typing = document.activeElement === input && input.value !== shown;
    if (typing || (now === shown && input.value !== shown)) return;
    shown = now;
    input.value = now;
    said(null);
  };
  const element = el('span', { class: 'number' }, input, el('i', { 'aria-hidden': 'true' }, unit));
  return { element, message, sync };
}

export const wrongLine = () => el('p', { class: 'wrong', role: 'alert', hidden: true });

// Three numbers of a place in the scene's world, in metres.
export function vector(app, { name, field, check }) {
  const { scale } = app.toModel;
  const message = wrongLine();
  const parts = ['X', 'Y', 'Z'].map((axis, i) => {
    const put = (light, v) => light[field].map((old, k) => (k === i ? v : old));
    const part = number(app, {
      name, label: `${name} ${axis}`, unit: 'm', message,
      // Rounding leaves traces where there should be nothing.
      read: (light) => (Math.abs(light[field][i]) * scale < 1e-5 ? 0 : light[field][i]),
      write: (v, light) => ({ [field]: put(light, v) }),
      check: (v, light) => check(put(light, v), light),
    });
    part.element.prepend(el('b', { class: axis.toLowerCase(), 'aria-hidden': 'true' }, axis));
    return part;
  });
  return {
    element: el('div', { class: 'vector', role: 'group', 'aria-label': name }, el('span', {}, name),
      el('div', {}, ...parts.map((part) => part.element)), message),
    sync: (light) => parts.forEach((part) => part.sync(light)),
  };
}
