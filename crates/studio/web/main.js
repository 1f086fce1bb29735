// The page: its state, what a person can do, and how the parts hang together.

import { Frames, get, post, put, remove } from './api.js';
import { Dialogs } from './dialogs.js';
import { History } from './history.js';
import { KINDS } from './kinds.js';
import { Lights, fresh } from './lights.js';
import { Look } from './look.js';
import { Photograph } from './photograph.js';
import { Shining } from './shining.js';
import { Similarity } from './space.js';
import { Stage } from './stage.js';

const $ = (id) => document.getElementById(id);

class App {
  constructor() {
    this.session = null;
    this.maps = [];
    this.head = 0;
    this.selected = 0;
    this.draft = null;
    this.compare = null;
    this.undone = [];
    this.done = [];
    this.work = Promise.resolve();
    // What the tests and the timing line read.
    this.metrics = { frames: [], edits: [], started: null };
    window.lumi = this;
  }

  async start() {
    this.look = new Look(this, $('look'));
    this.photograph = new Photograph(this);
    this.shining = new Shining(this, $('shown'));
    this.stage = new Stage(this);
    this.lights = new Lights(this, $('panel'));
    this.history = new History(this, $('tree'));
    this.dialogs = new Dialogs(this, $('dialog'));
    this.bind();
    try {
      this.info = await get('/api/studio');
      const wanted = new URLSearchParams(location.hash.slice(1)).get('session');
      await this.load(wanted ?? this.info.opening).catch(async (e) => {
        if (!wanted || !this.info.opening) throw e;
        await this.load(this.info.opening);
      });
    } catch (e) {
      this.failed('load', e.message);
    }
    document.body.classList.add('ready');
  }

  bind() {
    $('open').onclick = () => this.dialogs.open();
    $('export').onclick = () => this.dialogs.export();
    $('compare').onclick = () => this.toggleCompare();
    $('photograph').onclick = () => this.photograph.toggle();
    $('keys').onclick = () => this.dialogs.keys();
    $('undo').onclick = () => this.undo();
    $('redo').onclick = () => this.redo();
    $('delete').onclick = () => this.removeStep(this.head);
    $('side').onclick = () => this.stage.toggleSide();
    // The address after # names the session, so the link may not go there.
    document.querySelector('.skip').onclick = (event) => {
      event.preventDefault();
      $('panel').focus();
    };
    window.addEventListener('keydown', (event) => this.key(event));
    window.addEventListener('hashchange', () => {
      const wanted = new URLSearchParams(location.hash.slice(1)).get('session');
      if (wanted && wanted !== this.session?.id) this.load(wanted).catch((e) => this.failed('load', e.message));
    });
  }

  key(event) {
    const typing = event.target.matches?.('input, select, textarea') && event.target.type !== 'range';
    if (typing || $('dialog').open) return;
    const command = event.ctrlKey || event.metaKey;
    const key = event.key.toLowerCase();
    const acts = {
      z: () => command && (event.shiftKey ? this.redo() : this.undo()),
      y: () => command && this.redo(),
      c: () => !command && this.toggleCompare(),
      e: () => !command && this.dialogs.export(),
      o: () => !command && this.dialogs.open(),
      b: () => !command && this.look.next(),
      p: () => !command && this.photograph.toggle(),
      '?': () => this.dialogs.keys(),
      delete: () => this.removeStep(this.head),
      backspace: () => this.removeStep(this.head),
      escape: () => {
        this.photograph.leave();
        if (this.compare !== null) this.toggleCompare();
      },
      ...Object.fromEntries(Object.keys(KINDS).map((kind, i) => [i + 1, () => this.addLight(kind)])),
    };
    if (!acts[key] || (command && !'zy'.includes(key))) return;
    acts[key]();
    event.preventDefault();
  }

  // ---- sessions

  async loadMaps() {
    this.maps = (await get('/api/maps')).maps;
  }

  map(id) {
    return this.maps.find((m) => m.id === id);
  }

  async load(id) {
    if (!id) throw new Error('There is no session: open a capture.');
    await this.adopt(await get(`/api/sessions/${id}`));
  }

  // Makes a session the one that is shown, when the edits of the one before are done.
  async adopt(session) {
    await this.commit();
    // A session that the server has just opened can bring maps.
    await this.loadMaps();
    this.frames?.close();
    this.session = session;
    this.toModel = new Similarity(session.to_model);
    this.head = session.latest;
    this.selected = session.latest;
    Object.assign(this, { draft: null, compare: null, undone: [], done: [] });
    this.shining.reset();
    this.photograph.leave();
    this.dismiss();
    this.fine('load');
    history.replaceState(null, '', `#session=${session.id}`);
    document.title = `${session.name} · Lumi Studio`;
    $('scene-name').textContent = session.name;
    this.stage.reset();
    this.frames = new Frames(session.id, {
      // Whatever changed while there was no connection was not told; a restarted server also counts anew.
      open: () => {
        this.fine('connection');
        this.stage.request();
        this.mutate(() => this.refresh());
      },
      lost: () => this.failed('connection', 'The connection is lost; trying again…'),
      changed: (revision) => revision !== this.session.revision && this.mutate(() => this.refresh()),
      error: (text) => this.failed('frame', text),
      frame: (header, panes, asked) => {
        this.fine('frame');
        this.stage.frame(header, panes, asked);
      },
    });
    this.changed();
  }

  // Takes over what the server has now. `settled`: a draft that is part of it.
  async refresh(settled) {
    const session = await get(`/api/sessions/${this.session.id}`);
    const maps = session.nodes.flatMap((n) => n.edit?.lights ?? []).map((l) => l.map).filter(Boolean);
    if (!maps.every((id) => this.map(id))) await this.loadMaps();
    if (session.id !== this.session.id) return;
    // The server forgets removals when it opens a session anew, and may give their numbers to other steps.
    if (session.opened !== this.session.opened) Object.assign(this, { undone: [], done: [] });
    this.session = session;
    if (this.draft && (this.draft === settled || !this.node(this.draft.node))) this.draft = null;
    // A step that somebody else removed is left for the last one that is still there.
    if (!this.node(this.head)) this.head = session.latest;
    if (!this.path(this.head).some((n) => n.id === this.selected)) this.selected = this.head;
    if (this.compare !== null && !this.node(this.compare)) this.compare = null;
    this.changed();
  }

  node(id) {
    return this.session.nodes.find((n) => n.id === id);
  }

  path(id) {
    const path = [];
    for (let node = this.node(id); node; node = this.node(node.parent)) path.unshift(node);
    return path;
  }

  children(id) {
    return this.session.nodes.filter((n) => n.parent === id);
  }

  // The edit that the panel and the handles show: a draft while it is being changed.
  edit() {
    if (this.draft?.node === this.selected) return this.draft.edit;
    return this.node(this.selected)?.edit ?? null;
  }

  // Everything that depends on the state is drawn again.
  changed() {
    this.stage.request();
    this.lights.render();
    this.shining.render();
    this.history.render();
    $('undo').disabled = !this.done.length && this.node(this.head)?.parent == null;
    $('redo').disabled = !this.undone.length && !this.children(this.head).length;
    $('delete').disabled = this.head === 0;
    $('compare').setAttribute('aria-pressed', String(this.compare !== null));
    $('photograph').setAttribute('aria-pressed', String(this.photograph.shown !== null));
  }

  // ---- edits

  // One after the other: each knows the versions that the one before left. Another session may be shown when its turn
  // comes, or after each wait: then it leaves the page's state alone, which `here` tells.
  mutate(act) {
    if (!this.session) return this.work;
    const { id } = this.session;
    const here = () => this.session.id === id;
    this.work = this.work.then(() => here() && act(here)).then(() => this.fine('edit')).catch(async (e) => {
      this.failed('edit', e.message);
      if (!here()) return;
      this.draft = null;
      await this.refresh().catch(() => {});
    });
    return this.work;
  }

  url(rest) {
    return `/api/sessions/${this.session.id}/${rest}`;
  }

  addLight(kind, values = {}) {
    if (!this.session) return this.work;
    const light = { ...fresh(kind, this), ...values };
    const mode = kind === 'environment' ? 'set' : 'add';
    const available = this.info.modes.find((m) => m.mode === mode)?.available;
    const named = this.history.fresh(kind);
    const edit = { ...named, mode: available ? mode : this.info.modes.find((m) => m.available).mode, lights: [light] };
    // A new light is to be seen.
    this.shining.solo = null;
    this.metrics.started = performance.now();
    this.commit();
    return this.mutate(async (here) => {
      const parent = this.head;
      const made = await post(this.url('nodes'), { parent, edit });
      if (!here()) return;
      this.did({ kind: 'go', from: parent, to: made.id });
      this.head = made.id;
      this.selected = made.id;
      await this.refresh();
      if (here() && edit.mode === 'set') this.replaced(made.id, here);
    });
  }

  // Says which light a step has just turned off.
  replaced(id, here) {
    const off = this.shining.entries(this.node(id).parent).filter((e) => !e.taken).map((e) => this.shining.name(e));
    const list = off.length > 3 ? `${off.length} lights` : off.join(', ').replace(/, ([^,]*)$/, ' and $1');
    this.toast(`${this.history.name(id)} replaces all light: ${list} ${off.length === 1 ? 'is' : 'are'} off.`, false,
      ['Undo', () => here() && this.undo()]);
  }

  // Shows a change of the selected step without keeping it.
  preview(edit) {
    if (this.draft && this.draft.node !== this.selected) this.commit();
    this.draft = { node: this.selected, edit };
    this.stage.request(true);
    this.lights.sync();
    this.shining.render();
  }

  // Keeps the change that is shown, of the step that it was made for. It stays the draft until the server has it.
  commit() {
    const { draft } = this;
    if (!draft || draft.kept || !this.node(draft.node)?.edit) return this.work;
    const { node: id, edit } = draft;
    draft.kept = true;
    this.stage.request();
    return this.mutate(async (here) => {
      const node = this.node(id);
      if (!node) return;
      const before = node.edit;
      if (JSON.stringify(before) !== JSON.stringify(edit)) {
        await put(this.url(`nodes/${id}`), { version: node.version, edit });
        if (!here()) return;
        this.did({ kind: 'change', id, before, after: edit });
      }
      await this.refresh(draft);
      if (here() && edit.mode === 'set' && before.mode !== 'set') this.replaced(id, here);
    });
  }

  // Changes some values of the light of the selected step.
  change(values, keep = false) {
    const edit = structuredClone(this.edit());
    if (!edit) return;
    Object.assign(edit.lights[0], values);
    this.preview(edit);
    if (keep) this.commit();
  }

  setMode(mode) {
    const edit = structuredClone(this.edit());
    if (!edit) return;
    this.preview({ ...edit, mode });
    this.commit();
  }

  // Another name of the selected step; its usual one again if there is none.
  rename(name) {
    const edit = structuredClone(this.edit());
    delete edit.name;
    this.preview(name ? { name, ...edit } : edit);
    this.commit();
  }

  did(action) {
    this.dismiss();
    this.done.push(action);
    this.undone = [];
    if (this.done.length > 200) this.done.shift();
  }

  go(id, selected = id) {
    if (!this.node(id)) return;
    this.commit();
    this.head = id;
    this.selected = selected;
    this.changed();
  }

  select(id) {
    this.commit();
    this.selected = id;
    this.changed();
  }

  // Walking the history by hand is not itself a step to be undone.
  undo() {
    this.commit();
    return this.mutate(async (here) => {
      this.dismiss();
      const action = this.done.pop();
      if (action) {
        this.undone.push(action);
        await this.act(action, false, here);
      } else if (this.node(this.head)?.parent != null) {
        this.go(this.node(this.head).parent);
      }
    });
  }

  redo() {
    this.commit();
    return this.mutate(async (here) => {
      const action = this.undone.pop();
      if (action) {
        this.done.push(action);
        await this.act(action, true, here);
      } else {
        const next = this.children(this.head);
        if (next.length) this.go(next[next.length - 1].id);
      }
    });
  }

  async act(action, forward, here) {
    if (action.kind === 'go') {
      this.go(forward ? action.to : action.from);
    } else if (action.kind === 'change') {
      const node = this.node(action.id);
      if (!node) return;
      const edit = forward ? action.after : action.before;
      await put(this.url(`nodes/${node.id}`), { version: node.version, edit });
      if (!here()) return;
      await this.refresh();
      if (!here()) return;
      if (!this.path(this.head).some((n) => n.id === node.id)) this.go(node.id);
      else this.select(node.id);
    } else if (action.kind === 'remove') {
      if (forward) await remove(this.url(`nodes/${action.id}`));
      else await post(this.url('restore'), { node: action.id });
      if (!here()) return;
      await this.refresh();
      if (!here()) return;
      this.go(forward ? action.parent : action.head);
    }
  }

  removeStep(id) {
    if (id === 0) return this.work;
    this.commit();
    return this.mutate(async (here) => {
      const node = this.node(id);
      if (!node) return;
      const { parent } = node;
      const { removed } = await remove(this.url(`nodes/${id}`));
      if (!here()) return;
      const action = { kind: 'remove', id, parent, head: this.head };
      this.did(action);
      this.head = parent;
      this.selected = parent;
      await this.refresh();
      if (!here()) return;
      const what = removed === 1 ? 'Step removed.' : `${removed} steps removed.`;
      this.toast(what, false, ['Undo', () => here() && this.undo()]);
    });
  }

  toggleCompare(with_) {
    this.photograph.leave();
    const other = with_ ?? this.node(this.head)?.parent ?? 0;
    this.compare = this.compare === null || with_ !== undefined ? other : null;
    this.changed();
  }

  // ---- messages

  // Something failed; the message stays until the same succeeds, at most as long as people read.
  failed(kind, text) {
    this.fine(kind);
    this.toast(text, true).dataset.kind = kind;
  }

  fine(kind) {
    [...$('toasts').children].filter((t) => t.dataset.kind === kind).forEach((t) => t.remove());
  }

  // What could be undone is no longer the last thing that was done.
  dismiss() {
    [...$('toasts').children].filter((t) => t.querySelector('button')).forEach((t) => t.remove());
  }

  toast(text, wrong = false, action = null) {
    const box = $('toasts');
    const same = [...box.children].find((t) => t.firstChild.textContent === text);
    same?.remove();
    const toast = document.createElement('div');
    toast.className = wrong ? 'toast wrong' : 'toast';
    toast.append(document.createElement('span'));
    toast.firstChild.textContent = text;
    if (action) {
      const button = document.createElement('button');
      button.textContent = action[0];
      button.onclick = () => {
        toast.remove();
        action[1]();
      };
      toast.append(button);
    }
    box.append(toast);
    // Without a connection nothing else works: that is said until it is back.
    setTimeout(() => toast.dataset.kind !== 'connection' && toast.remove(), wrong || action ? 8000 : 5000);
    return toast;
  }
}

new App().start();
