// Opening captures and sessions, and taking results away.

import { call, get, post, remove } from './api.js';
import { el, icon } from './dom.js';
import { keys } from './keys.js';
import { kind, record } from './turntable.js';

const FOLDER = 'M2 4h4l1.500 2H14v7H2z';
const ZIP = 'M4 2h6l3 3v9H4zM7 2v6M9 4H7M9 6H7';
const FILE = 'M4 2h5l3 3v9H4zM9 2v3h3';

export class Dialogs {
  constructor(app, dialog) {
    Object.assign(this, { app, dialog });
    dialog.addEventListener('click', (event) => event.target === dialog && dialog.close());
    dialog.addEventListener('close', () => app.stage.root.append(this.toasts));
    this.toasts = document.getElementById('toasts');
  }

  show(title, ...content) {
    const close = el('button', { class: 'quiet', 'aria-label': 'Close', title: 'Close (Esc)', onclick: () => this.dialog.close() },
      icon('M4 4l8 8M12 4l-8 8'));
    this.dialog.replaceChildren(el('div', { class: 'sheet' },
      el('header', {}, el('h1', { id: 'dialog-title', tabindex: '-1', autofocus: true }, title), close), ...content),
    // Messages outside an open dialog lie below its backdrop.
    this.toasts);
    if (!this.dialog.open) this.dialog.showModal();
  }

  // ---- open

  async open() {
    const pick = (attributes, act) => {
      const input = el('input', { type: 'file', hidden: true, ...attributes });
      input.onchange = () => input.files.length && act([...input.files]);
      return input;
    };
    const folder = pick({ webkitdirectory: true, id: 'pick-folder' }, (files) => this.upload(files.map((f) => [f.webkitRelativePath, f])));
    const zip = pick({ accept: '.zip', id: 'pick-zip' }, ([file]) => this.upload([[file.name, file]]));
    const saved = pick({ accept: '.lumi-session', id: 'pick-session' }, ([file]) => this.loadFile(file));
    const card = (path, name, note, input) => el('button', { class: 'card', onclick: () => input.click() },
      icon(path), el('b', {}, name), el('span', {}, note), input);
    const list = el('div', { class: 'sessions' });
    this.show('Open',
      el('div', { class: 'cards' },
        card(FOLDER, 'Capture folder', 'photos with camera poses', folder),
        card(ZIP, 'Capture as a zip', 'the same, packed', zip),
        card(FILE, 'Session file', 'a saved .lumi-session', saved)),
      el('p', { class: 'note' }, 'Or drop any of these anywhere on the page. Files stay on the machine that runs the studio.'),
      list);
    try {
      const { sessions } = await get('/api/sessions');
      if (sessions.length) list.append(el('h2', {}, 'Sessions'));
      for (const session of sessions) list.append(this.row(session));
      this.app.fine('sessions');
    } catch (e) {
      this.app.failed('sessions', e.message);
    }
  }

  row(session) {
    const current = session.id === this.app.session?.id;
    const when = session.modified ? new Date(session.modified * 1000).toLocaleString([], { dateStyle: 'medium', timeStyle: 'short' }) : 'not changed yet';
    const steps = session.steps === 1 ? 'no edits' : `${session.steps - 1} ${session.steps === 2 ? 'edit' : 'edits'}`;
    const open = el('button', {
      class: 'row', disabled: !session.usable, 'data-session': session.id,
      title: session.usable ? 'Open' : 'Made with another model, to which its tokens mean nothing',
      onclick: async () => {
        try {
          await this.app.load(session.id);
          this.app.fine('sessions');
          this.dialog.close();
        } catch (e) {
          this.app.failed('sessions', e.message);
        }
      },
    }, el('b', {}, session.name), el('span', {}, `${steps} · ${session.usable ? when : 'another model'}${current ? ' · open now' : ''}`));
    const row = el('div', { class: 'session' }, open);
    if (!current) {
      row.append(el('button', {
        class: 'quiet', title: 'Delete this session', 'aria-label': `Delete session ${session.name}`,
        onclick: async () => {
          if (!window.confirm(`Delete the session “${session.name}” for good?`)) return;
          try {
            await remove(`/api/sessions/${session.id}`);
            row.remove();
            this.app.fine('sessions');
          } catch (e) {
            this.app.failed('sessions', e.message);
          }
        },
      }, icon('M3 4.500h10M6.500 4.500V3h3v1.500M4.500 4.500l.6 9h5.800l.6-9')));
    }
    return row;
  }

  async loadFile(file) {
    this.busy('Reading the session', file.name);
    try {
      await this.app.adopt(await post('/api/sessions/load', file));
      this.dialog.close();
    } catch (e) {
      this.failed('This session cannot be opened', e.message);
    }
  }

  busy(title, text) {
    this.show(title, el('div', { class: 'busy', role: 'status' }, el('i', { class: 'spinner' }), el('p', {}, text)));
  }

  failed(title, text) {
    this.show(title, el('p', { class: 'error', role: 'alert' }, text),
      el('footer', {}, el('button', { onclick: () => this.open() }, 'Try another')));
  }

  // ---- upload and check

  async upload(files) {
    const size = files.reduce((sum, [, file]) => sum + file.size, 0);
    const count = files.length === 1 ? files[0][0] : `${files.length} files`;
    this.busy('Looking at the capture', `${count}, ${(size / 2 ** 20).toFixed(1)} MiB: poses, masks, exposure…`);
    const form = new FormData();
    for (const [path, file] of files) form.append(path, file);
    try {
      const { id, check } = await call('POST', '/api/uploads', form);
      this.checked(id, check);
    } catch (e) {
      this.failed('This capture cannot be opened', e.message);
    }
  }

  // What `lumi scene check` says, with its pictures, before anything is encoded.
  checked(id, check) {
    const { report } = check;
    const pictures = el('div', { class: 'pictures' });
    check.views.forEach((name, i) => pictures.append(el('img', { src: `/api/uploads/${id}/views/${i}`, alt: name, title: name })));
    const facts = el('dl', { class: 'facts' });
    const fact = (name, value) => value != null && facts.append(el('dt', {}, name), el('dd', {}, value));
    fact('Views', `${report.inputs} to encode, ${report.targets} held out`);
    fact('Size', report.sizes.map(([w, h]) => `${w}×${h}`).join(', '));
    fact('Cameras', `${report.sound_cameras} of ${report.views.length} sound`);
    fact('Masks', `${report.masks} of ${report.views.length}`);
    if (report.hull_median !== null) fact('Poses agree', `${(100 * report.hull_median).toFixed(0)} %`);
    if (report.exposure) fact('Exposure', `mean ${report.exposure.mean.toFixed(2)}`);
    const problems = el('ul', { class: 'problems' });
    for (const p of report.problems.slice(0, 12)) {
      problems.append(el('li', { class: p.severity }, el('b', {}, p.field), ` ${p.text}`));
    }
    if (!report.problems.length) problems.append(el('li', { class: 'good' }, 'No problems found.'));
    const most = Math.min(32, report.inputs);
    const shown = el('output', {}, String(Math.min(8, most)));
    const count = el('input', { type: 'range', min: 1, max: Math.max(most, 1), value: Math.min(8, most), 'aria-label': 'Input views', oninput: () => fill() });
    const fill = () => {
      shown.textContent = count.value;
      count.style.setProperty('--at', `${(100 * (count.value - 1)) / Math.max(most - 1, 1)}%`);
    };
    fill();
    const options = [el('label', { class: 'field' }, el('span', {}, 'Input views'), shown, count)];
    let source = null;
    if (check.sources.length) {
      source = el('select', { 'aria-label': 'Captured light' }, ...check.sources.map((s) => el('option', { value: s }, s)));
      const usual = report.lights.find((l) => l.kind === 'environment')?.name;
      if (usual) source.value = usual;
      options.push(el('label', { class: 'field' }, el('span', {}, 'Captured light'), source));
    }
    const encode = el('button', {
      class: 'primary', id: 'encode', disabled: !check.usable,
      onclick: async () => {
        this.busy('Encoding', `${count.value} views become scene tokens…`);
        try {
          const session = await post('/api/sessions', { upload: id, inputs: Number(count.value), source: source?.value ?? null });
          await this.app.adopt(session);
          this.dialog.close();
        } catch (e) {
          this.failed('This capture cannot be encoded', e.message);
        }
      },
    }, 'Encode');
    this.show(report.name,
      el('div', { class: 'check' }, el('div', {}, pictures, this.dome(check.cameras)), el('div', {}, facts, problems, ...options)),
      el('details', {}, el('summary', {}, 'The whole check, as lumi scene check prints and draws it'), el('pre', {}, check.text),
        el('a', { class: 'whole', href: `/api/uploads/${id}/picture`, target: '_blank', title: 'Open the whole check' },
          el('img', { src: `/api/uploads/${id}/picture`, alt: 'The check on one page: where the cameras stand, and every view with its mask' }))),
      el('footer', {}, el('button', { onclick: () => this.open() }, 'Back'), encode));
    encode.focus();
  }

  // The cameras from above, around the scene's ball.
  dome(cameras) {
    const far = Math.max(1.5, ...cameras.map((c) => Math.hypot(c[0], c[1])));
    const mark = (x, y, z) => `<circle cx="${(60 + (50 * x) / far).toFixed(1)}" cy="${(60 - (50 * y) / far).toFixed(1)}" r="2.600" opacity="${z < 0 ? 0.35 : 0.95}"/>`;
    const holder = el('div', { class: 'dome' });
    holder.innerHTML = `<svg viewBox="0 0 120 120" role="img" aria-label="Cameras from above"><circle class="ball" cx="60" cy="60" r="${(50 / far).toFixed(1)}"/>${cameras.map(([x, y, z]) => mark(x, y, z)).join('')}</svg>`;
    holder.append(el('span', {}, `${cameras.length} cameras, from above`));
    return holder;
  }

  // What was dropped: a map, a session, a zip, or a folder.
  async dropped(transfer) {
    this.app.fine('drop');
    const items = [...transfer.items].map((i) => i.webkitGetAsEntry?.()).filter(Boolean);
    const plain = [...transfer.files];
    const named = (pattern) => plain.filter((f) => pattern.test(f.name));
    if (!items.some((i) => i.isDirectory)) {
      const maps = named(/\.(hdr|exr|jpe?g|png)$/i);
      if (maps.length && maps.length === plain.length) return this.app.lights.addMaps(maps);
      const [session] = named(/\.lumi-session$/i);
      if (session) return this.loadFile(session);
      const [zip] = named(/\.zip$/i);
      if (zip) return this.upload([[zip.name, zip]]);
    }
    const files = [];
    const walk = async (entry, path) => {
      if (entry.isFile) {
        files.push([path + entry.name, await new Promise((done, bad) => entry.file(done, bad))]);
        return;
      }
      const reader = entry.createReader();
      for (;;) {
        const some = await new Promise((done, bad) => reader.readEntries(done, bad));
        if (!some.length) return;
        for (const e of some) await walk(e, `${path}${entry.name}/`);
      }
    };
    for (const item of items) await walk(item, '');
    if (files.length) return this.upload(files);
    return this.app.failed('drop', 'Expected a capture (folder or zip), a session, or an environment map (.hdr, .exr, or a .jpg or .png panorama).');
  }

  keys() {
    this.show('Keys', keys());
  }

  // ---- export

  async export() {
    const { app } = this;
    if (!app.session) return;
    const at = new URLSearchParams({ ...app.stage.camera, ...app.look.shown() }).toString();
    const step = app.url(`nodes/${app.head}`);
    const size = app.info.model.resolution;
    const card = (path, name, note, href, id) => el('a', { class: 'card', href, download: '', id }, icon(path), el('b', {}, name), el('span', {}, note));
    const picture = 'M2 3h12v10H2zM2 11l3.500-4 3 3 2-2 3.500 3';
    const turn = 'M8 3a6 3 0 1 0 6 3M14 2v4h-4M8 9v4';
    const text = 'M4 2h5l3 3v9H4zM6 8h4M6 10.500h4';
    const command = el('pre', { tabindex: '0', 'aria-label': 'Command line' }, '…');
    const copy = el('button', {
      onclick: async () => {
        try {
          await navigator.clipboard.writeText(command.textContent);
          app.fine('copy');
        } catch {
          // There is no clipboard for pages that came over plain HTTP from another machine.
          app.failed('copy', 'The browser does not let the page copy: select the text and copy it.');
          return;
        }
        copy.textContent = 'Copied';
        setTimeout(() => { copy.textContent = 'Copy'; }, 1500);
      },
    }, 'Copy');
    this.show('Export',
      el('div', { class: 'cards' },
        card(picture, 'Picture', 'PNG, 1024 px', `${step}/picture/png?${at}&size=1024`, 'get-png'),
        card(picture, 'Cut-out', 'PNG with alpha, 1024 px', `${step}/picture/png?${at}&size=1024&alpha=true`, 'get-cut-out'),
        card(picture, 'Linear picture', `OpenEXR with alpha, ${size} px as rendered`, `${step}/picture/exr?${at}`, 'get-exr'),
        ...(kind() ? [this.video(turn, step)] : []),
        card(turn, 'Turntable, animation', 'GIF, once around', `${step}/turntable?${at}&size=480&frames=60`, 'get-turntable'),
        card(text, 'Edits', 'edits.toml for lumi relight', `${step}/edits`, 'get-edits'),
        card(FILE, 'Session', 'everything, to go on later', app.url('file'), 'get-session')),
      el('h2', {}, 'The same picture from the command line'),
      el('div', { class: 'command' }, command, copy));
    try {
      command.textContent = (await get(`${step}/command?${new URLSearchParams(app.stage.camera)}`)).command;
    } catch (e) {
      command.textContent = e.message;
    }
  }

  // The card that records a turntable; it tells how far it is while the rest of the page goes on.
  video(path, step) {
    const { app } = this;
    const camera = { ...app.stage.camera };
    const address = (share) => `${step}/picture/png?${new URLSearchParams({ ...camera, ...app.look.shown(), azimuth: camera.azimuth + 2 * Math.PI * share })}&size=720`;
    const usual = `${kind()[1].toUpperCase()}, 720 px, once around`;
    const note = el('span', {}, usual);
    const button = el('button', {
      class: 'card', id: 'get-video',
      onclick: async () => {
        button.disabled = true;
        try {
          const { blob, extension } = await record(address, { told: (share) => { note.textContent = `Recording… ${Math.round(100 * share)} %`; } });
          const href = URL.createObjectURL(blob);
          el('a', { href, download: `${app.session.name}-step${app.head}-turntable.${extension}` }).click();
          setTimeout(() => URL.revokeObjectURL(href), 60_000);
          app.fine('video');
        } catch (e) {
          app.failed('video', `Turntable: ${e.message}`);
        } finally {
          note.textContent = usual;
          button.disabled = false;
        }
      },
    }, icon(path), el('b', {}, 'Turntable, video'), note);
    return button;
  }
}
