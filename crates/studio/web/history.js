// The history: a tree of thumbnails, time from left to right, branches below each other.

import { el, icon } from './dom.js';
import { KINDS } from './kinds.js';

const STEP = 84;
const ROW = 96;
const THUMB = 64;
const VERBS = { set: '', add: '+ ', remove: '− ' };

export class History {
  constructor(app, root) {
    Object.assign(this, { app, root, key: null });
    root.addEventListener('keydown', (event) => this.walk(event));
  }

  title(id) {
    const node = this.app.node(id);
    return node?.edit ? `${VERBS[node.edit.mode]}${this.name(id)}` : 'Captured';
  }

  // What a step is called: as a person wishes, else by its map or by its number among the lights of its kind.
  name(id) {
    const node = this.app.node(id);
    if (!node?.edit) return 'Captured';
    const edit = this.app.draft?.node === id ? this.app.draft.edit : node.edit;
    const [{ kind, map }] = edit.lights;
    if (edit.name) return edit.name;
    if (kind === 'environment') return this.app.map(map)?.name ?? KINDS.environment.name;
    return `${KINDS[kind].usual} ${this.same(kind).indexOf(node) + 1}`;
  }

  same(kind) {
    return this.app.session.nodes.filter((n) => n.edit?.lights[0].kind === kind);
  }

  // The name of a new step, one that no other has; none for environments, which are called by their maps.
  fresh(kind) {
    const { usual } = KINDS[kind];
    if (!usual) return {};
    const same = this.same(kind);
    const number = (n) => Number(this.name(n.id).match(/ (\d+)$/)?.[1] ?? 0);
    return { name: `${usual} ${1 + Math.max(same.length, ...same.map(number))}` };
  }

  // Column by depth; the first child continues its parent's row, the others get rows of their own.
  layout() {
    const { nodes } = this.app.session;
    const children = new Map(nodes.map((n) => [n.id, []]));
    for (const n of nodes) if (n.parent !== null) children.get(n.parent)?.push(n.id);
    const at = new Map();
    let rows = 0;
    // A stack, since histories can be deep: [node, column, row or null for a new one].
    const stack = [[nodes[0].id, 0, 0]];
    while (stack.length) {
      const [id, column, given] = stack.pop();
      const row = given ?? (rows += 1);
      at.set(id, { column, row });
      const below = children.get(id);
      for (let i = below.length - 1; i >= 0; i -= 1) stack.push([below[i], column + 1, i === 0 ? row : null]);
    }
    return { at, rows: rows + 1, columns: Math.max(...[...at.values()].map((p) => p.column)) + 1 };
  }

  render() {
    const { app } = this;
    const { session } = app;
    const key = JSON.stringify([session.id, session.opened, app.head, app.compare, app.selected, app.maps.length, session.nodes.map((n) => [n.id, n.version])]);
    if (key === this.key) return;
    this.key = key;
    const { at, rows, columns } = this.layout();
    const onPath = new Set(app.path(app.head).map((n) => n.id));
    const lines = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    const field = el('div', { class: 'field-of-steps' });
    field.style.width = `${columns * STEP + 8}px`;
    field.style.height = `${rows * ROW}px`;
    field.append(lines);
    const kept = new Map([...this.root.querySelectorAll('button.step')].map((b) => [b.dataset.key, b]));
    const focused = document.activeElement?.dataset?.node;
    for (const node of session.nodes) {
      const place = at.get(node.id);
      if (!place) continue;
      const x = place.column * STEP + 6;
      const y = place.row * ROW + 4;
      if (node.parent !== null) {
        const from = at.get(node.parent);
        const [px, py] = [from.column * STEP + 6 + THUMB, from.row * ROW + 4 + THUMB / 2];
        const line = document.createElementNS('http://www.w3.org/2000/svg', 'path');
        const [cx, cy] = [x, y + THUMB / 2];
        line.setAttribute('d', from.row === place.row ? `M${px} ${py}H${cx}` : `M${px} ${py}c10 0 4 ${cy - py} ${cx - px} ${cy - py}`);
        if (onPath.has(node.id)) line.classList.add('on');
        lines.append(line);
      }
      field.append(this.step(node, x, y, onPath, kept));
    }
    this.root.replaceChildren(field);
    this.root.closest('.history').style.setProperty('--rows', Math.min(rows, 2));
    if (focused !== undefined) this.root.querySelector(`[data-node="${focused}"]`)?.focus({ preventScroll: true });
    const current = this.root.querySelector('[aria-current]');
    current?.scrollIntoView({ block: 'nearest', inline: 'nearest' });
  }

  step(node, x, y, onPath, kept) {
    const { app } = this;
    const key = `${app.session.id}.${app.session.opened}.${node.id}.${node.version}`;
    const title = this.title(node.id);
    let button = kept.get(key);
    if (!button) {
      const image = el('img', { alt: '', width: THUMB, height: THUMB });
      image.onload = () => image.classList.add('in');
      image.src = `${app.url(`nodes/${node.id}/thumbnail`)}?v=${app.session.opened}.${node.version}`;
      button = el('button', { class: 'step', 'data-key': key, 'data-node': node.id }, image, el('span', { class: 'caption' }));
      if (node.edit) button.append(el('i', { class: 'badge' }, icon(KINDS[node.edit.lights[0].kind].icon)));
      button.onclick = (event) => {
        if (event.shiftKey) app.toggleCompare(node.id);
        else app.go(node.id);
      };
      button.oncontextmenu = (event) => {
        event.preventDefault();
        app.toggleCompare(node.id);
      };
    }
    button.querySelector('.caption').textContent = title;
    button.style.transform = `translate(${x}px, ${y}px)`;
    button.title = `${title}: click to go there, Shift-click to compare`;
    button.setAttribute('aria-label', `Step ${node.id}: ${title}`);
    button.classList.toggle('path', onPath.has(node.id));
    button.classList.toggle('compared', app.compare === node.id);
    button.tabIndex = node.id === app.head ? 0 : -1;
    if (node.id === app.head) button.setAttribute('aria-current', 'step');
    else button.removeAttribute('aria-current');
    return button;
  }

  // Arrow keys walk the tree.
  walk(event) {
    const id = Number(event.target.dataset?.node);
    const { app } = this;
    const node = app.node(id);
    if (!node) return;
    const siblings = node.parent === null ? [node] : app.children(node.parent);
    const i = siblings.indexOf(node);
    const children = app.children(id);
    const to = {
      ArrowLeft: app.node(node.parent),
      ArrowRight: children[children.length - 1],
      ArrowUp: siblings[i - 1],
      ArrowDown: siblings[i + 1],
    }[event.key];
    if (event.key.startsWith('Arrow')) event.preventDefault();
    if (!to) return;
    app.go(to.id);
    this.root.querySelector(`[data-node="${to.id}"]`)?.focus();
  }
}
