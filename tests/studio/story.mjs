// The whole story in headless Chromium: open, load, orbit, lights of every kind, typed numbers and names, undo, branch, compare,
// lights alone, export, and the saved session after a restart of the server.
//
//   node story.mjs LUMI OUT     LUMI: the program; OUT: a folder for screenshots and figures
//
// Needs playwright-core (NODE_PATH or node_modules) and a Chromium (CHROMIUM, default chromium).

import { spawn, spawnSync } from 'node:child_process';
import { mkdirSync, mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { delimiter, dirname, join, resolve } from 'node:path';
import assert from 'node:assert/strict';

const { chromium } = createRequire(join(process.cwd(), 'story.mjs'))('playwright-core');
const [program, out] = process.argv.slice(2);
mkdirSync(out, { recursive: true });
const work = mkdtempSync(join(tmpdir(), 'lumi-story-'));
const data = join(work, 'data');

// Starts the studio without a scene, on a free port; resolves with its address.
async function start() {
  const server = spawn(program, ['studio', '--port', '0', '--data', data], { stdio: ['ignore', 'pipe', 'inherit'] });
  const url = await new Promise((done, bad) => {
    let text = '';
    server.stdout.on('data', (chunk) => {
      text += chunk;
      const found = text.match(/http:\/\/[^\s]+/);
      if (found) done(found[0]);
    });
    server.on('exit', (code) => bad(new Error(`the studio ended with ${code}`)));
  });
  const stop = () => new Promise((done) => {
    server.removeAllListeners('exit');
    server.on('exit', (code) => done(code));
    server.kill('SIGINT');
  });
  return { url, stop };
}

const step = (text) => console.log(`- ${text}`);
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

let server = await start();
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync'],
});

async function open(width, height, extra = {}) {
  const context = await browser.newContext({ viewport: { width, height }, acceptDownloads: true, ...extra });
  const page = await context.newPage();
  const errors = [];
  page.on('pageerror', (e) => errors.push(e.message));
  page.on('console', (m) => m.type() === 'error' && errors.push(m.text()));
  // No request may leave for another host.
  const host = new URL(server.url).host;
  page.on('request', (r) => {
    const url = new URL(r.url());
    if (/^(http|ws)/.test(url.protocol) && url.host !== host) errors.push(`external request: ${r.url()}`);
  });
  return { context, page, errors };
}

const nodes = (page) => page.evaluate(() => window.lumi.session.nodes.length);
const head = (page) => page.evaluate(() => window.lumi.head);
const settled = async (page) => {
  await page.evaluate(() => window.lumi.work);
  await page.waitForFunction(() => {
    const { frames } = window.lumi;
    return frames && frames.sent.size === 0 && !frames.waiting && window.lumi.stage.picture.panes.length > 0;
  });
  await page.waitForTimeout(350);
};
// The mean of the middle of the picture, to see that light has changed.
const look = (page) => page.evaluate(() => {
  const pane = window.lumi.stage.picture.panes[0];
  const { data } = pane.getContext('2d').getImageData(pane.width / 4, pane.height / 4, pane.width / 2, pane.height / 2);
  let sum = [0, 0, 0];
  for (let i = 0; i < data.length; i += 4) sum = sum.map((s, c) => s + data[i + c]);
  return sum.map((s) => (4 * s) / data.length);
});
const differ = (a, b) => Math.max(...a.map((v, i) => Math.abs(v - b[i])));

try {
  const { page, errors, context } = await open(1280, 720);
  step('open: the bundled scene without being asked for one');
  await page.goto(server.url);
  await page.waitForSelector('body.ready');
  await settled(page);
  assert.equal(await nodes(page), 1);
  assert.equal(await page.locator('#views button').count(), 8);
  await page.screenshot({ path: join(out, '1-captured.png') });
  const captured = await look(page);

  step('orbit by dragging, zoom by scrolling');
  const box = await page.locator('#picture').boundingBox();
  const [cx, cy] = [box.x + box.width / 2, box.y + box.height / 2];
  const before = await page.evaluate(() => ({ ...window.lumi.stage.camera }));
  await page.mouse.move(cx - 150, cy);
  await page.mouse.down();
  await page.evaluate(() => { window.lumi.metrics.frames.length = 0; });
  for (let i = 1; i <= 90; i += 1) {
    await page.mouse.move(cx - 150 + 3 * i, cy + 30 * Math.sin(i / 15));
    await page.waitForTimeout(8);
  }
  await page.mouse.up();
  const dragged = await page.evaluate(() => window.lumi.metrics.frames.length);
  await page.mouse.wheel(0, -240);
  await settled(page);
  const after = await page.evaluate(() => ({ ...window.lumi.stage.camera }));
  assert.ok(Math.abs(after.azimuth - before.azimuth) > 0.5 && after.distance < before.distance, 'the camera moved');
  assert.ok(dragged > 21, 'frames came while dragging');
  // As fast as the page draws: the moves above wait for one another, and for this script.
  const orbit = await page.evaluate(() => new Promise((done) => {
    const { stage, metrics } = window.lumi;
    metrics.frames.length = 0;
    const end = performance.now() + 3000;
    const step = (now) => {
      stage.turn(0.02, 0);
      if (now < end) requestAnimationFrame(step);
      else done(metrics.frames.map(({ at, quality }) => ({ at, quality })));
    };
    requestAnimationFrame(step);
  }));
  const frames = orbit.map((f) => f.at);
  const intervals = frames.slice(1).map((t, i) => t - frames[i]);
  assert.ok(intervals.length > 20, 'frames came while turning');
  await settled(page);
  await page.mouse.wheel(0, 240);
  await page.locator('#picture').dblclick({ position: { x: box.width / 2, y: box.height - 30 } });
  await page.waitForTimeout(700);

  step('three lights: environment, point, area');
  await page.locator('[data-add=environment]').click();
  await settled(page);
  assert.ok(differ(await look(page), captured) > 1, 'the environment changes the picture');

  step('replacing all light is announced, and undone with one click');
  const told = page.locator('.toast', { hasText: 'replaces all light: Captured light is off.' });
  await told.waitFor();
  await page.screenshot({ path: join(out, '2-replaced.png') });
  await told.getByRole('button', { name: 'Undo' }).click();
  await settled(page);
  assert.equal(await head(page), 0);
  assert.ok(differ(await look(page), captured) < 1, 'the captured light is back');
  assert.equal(await page.locator('.toast').count(), 0);
  await page.keyboard.press('Control+Shift+z');
  await settled(page);
  assert.equal(await head(page), 1);
  await page.locator('.map').nth(1).click();
  await settled(page);
  assert.equal(await nodes(page), 2, 'another map changes the step, it adds none');
  await page.screenshot({ path: join(out, '2-environment.png') });
  step('what lights the scene can stand behind it');
  const corner = () => page.evaluate(() => [...document.getElementById('picture').getContext('2d').getImageData(4, 4, 1, 1).data]);
  const dark = await corner();
  await page.locator('.swatch.environment').click();
  await page.waitForFunction((dark) => {
    const now = document.getElementById('picture').getContext('2d').getImageData(4, 4, 1, 1).data;
    return Math.hypot(...dark.slice(0, 3).map((v, i) => v - now[i])) > 20;
  }, dark);
  await page.screenshot({ path: join(out, '2-backdrop.png') });
  await page.locator('.swatch.dark').click();
  await page.waitForFunction((dark) => {
    const now = document.getElementById('picture').getContext('2d').getImageData(4, 4, 1, 1).data;
    return dark.every((v, i) => v === now[i]);
  }, dark);
  const strip = await page.locator('.panorama').boundingBox();
  await page.mouse.move(strip.x + 60, strip.y + 40);
  await page.mouse.down();
  await page.mouse.move(strip.x + 130, strip.y + 40, { steps: 12 });
  await page.mouse.up();
  await settled(page);
  assert.notEqual(await page.evaluate(() => window.lumi.edit().lights[0].rotate), 0, 'dragging rotates the map');
  const plain = await look(page);
  await page.locator('[data-add=point]').click();
  await settled(page);
  assert.ok(differ(await look(page), plain) > 1, 'the point light changes the picture');
  const lamp = page.locator('.light.active .lamp');
  const at = await lamp.locator('.core').boundingBox();
  const position = () => page.evaluate(() => window.lumi.edit().lights[0].position);
  const stood = await position();
  await page.mouse.move(at.x + at.width / 2, at.y + at.height / 2);
  await page.mouse.down();
  await page.mouse.move(at.x + 70, at.y + 60, { steps: 25 });
  await page.mouse.up();
  await settled(page);
  assert.notDeepEqual(await position(), stood, 'dragging moves the light');
  const tip = await page.locator('.light.active .tip.z circle').last().boundingBox();
  const low = (await position())[2];
  await page.mouse.move(tip.x + tip.width / 2, tip.y + tip.height / 2);
  await page.mouse.down();
  await page.mouse.move(tip.x + tip.width / 2, tip.y - 25, { steps: 10 });
  await page.mouse.up();
  await settled(page);
  assert.ok((await position())[2] > low, 'the z arrow moves it up');
  await page.screenshot({ path: join(out, '3-point.png') });
  await page.locator('[data-add=area]').click();
  await settled(page);
  await page.screenshot({ path: join(out, '4-area.png') });
  assert.equal(await nodes(page), 4);

  step('numbers that are typed: applied, refused with a reason, taken back');
  const light = () => page.evaluate(() => window.lumi.edit().lights[0]);
  const field = (name) => page.locator(`[data-number="${name}"]`);
  const type = async (name, text, key = 'Enter') => {
    await field(name).click();
    await field(name).fill(text);
    await field(name).press(key);
    await settled(page);
  };
  const wrong = page.locator('.panel .wrong:visible');
  for (const [name, text, read, value] of [
    ['Power', '0.12 kW', (l) => l.power, 120], ['Size', '1,5', (l) => l.size, 1.5], ['Position Z', '3.25', (l) => l.position[2], 3.25],
    ['Target X', '0.2', (l) => l.target[0], 0.2]]) {
    await type(name, text);
    assert.ok(Math.abs(read(await light()) - value) < 1e-5, `${name} is ${text}`);
  }
  await type('Around', '60');
  const [px, py] = (await light()).position;
  assert.ok(Math.abs(Math.atan2(py, px) - Math.PI / 3) < 1e-3, 'degrees around');
  assert.equal(await page.locator('.panel .wrong:visible').count(), 0);
  const kept = await light();
  await type('Power', 'bright');
  assert.match(await wrong.textContent(), /^Power: expected a number, found “bright”\.$/);
  await page.screenshot({ path: join(out, '4-numbers.png') });
  await field('Power').press('Escape');
  assert.equal(await field('Power').inputValue(), '120');
  await type('Power', '-3');
  assert.match(await wrong.textContent(), /^Power: expected 0.001 to/);
  await type('Power', '77', 'Escape');
  assert.equal(await wrong.count(), 0);
  assert.deepEqual(await light(), kept, 'nothing of it was kept');
  await type('Distance', '0.2');
  assert.match(await wrong.textContent(), /^Distance: expected 1.05 to 20 radii/);
  await field('Distance').press('Escape');

  step('the bundled model was trained for every mode');
  for (const mode of ['set', 'add', 'remove']) {
    const button = page.locator(`[data-mode=${mode}]`).first();
    assert.equal(await button.getAttribute('aria-disabled'), 'false', mode);
  }

  step('by keyboard: power of the light');
  const power = () => page.evaluate(() => window.lumi.edit().lights[0].power);
  const was = await power();
  await page.locator('[aria-label=Power]').first().focus();
  await page.locator('input[aria-label=Power]').focus();
  for (let i = 0; i < 40; i += 1) await page.keyboard.press('ArrowRight');
  await settled(page);
  assert.ok((await power()) > was, 'arrow keys change the slider');

  step('undo, redo');
  await page.locator('#picture').focus();
  for (let i = 0; i < 60 && (await head(page)) === 3; i += 1) {
    await page.keyboard.press('Control+z');
    await settled(page);
  }
  assert.equal(await head(page), 2);
  await page.keyboard.press('Control+Shift+z');
  await settled(page);
  assert.equal(await head(page), 3);

  step('branch: back to the environment, another light');
  await page.locator('.step[data-node="1"]').click();
  await settled(page);
  await page.keyboard.press('3');
  await settled(page);
  assert.equal(await nodes(page), 5);
  assert.equal(await page.evaluate(() => window.lumi.children(1).length), 2);

  step('compare the two branches');
  await page.locator('.step[data-node="3"]').click({ modifiers: ['Shift'] });
  await settled(page);
  assert.equal(await page.evaluate(() => window.lumi.stage.picture.panes.length), 2);
  await page.screenshot({ path: join(out, '5-compare.png') });
  const line = await page.locator('#split').boundingBox();
  await page.mouse.move(line.x + 14, line.y + line.height / 2);
  await page.mouse.down();
  await page.mouse.move(line.x - 120, line.y + line.height / 2, { steps: 5 });
  await page.mouse.up();
  assert.ok((await page.evaluate(() => window.lumi.stage.split)) < 0.45);
  await page.locator('#side').click();
  await page.screenshot({ path: join(out, '6-side-by-side.png') });
  await page.locator('#side').click();
  await page.keyboard.press('Escape');
  await settled(page);

  step('compare with the nearest photograph; what moves the camera ends it');
  await page.keyboard.press('p');
  await page.waitForFunction(() => window.lumi.photograph.shown);
  await settled(page);
  assert.match(await page.locator('#tag-a').textContent(), /^Photograph /);
  await page.screenshot({ path: join(out, '6-photograph.png') });
  await page.locator('#picture').focus();
  await page.keyboard.press('ArrowLeft');
  await settled(page);
  assert.equal(await page.locator('#tags').isHidden(), true);
  assert.equal(await page.locator('.views .nearest').count(), 1);
  await page.locator('.views button').nth(3).hover();
  await page.locator('#overlay .mark').waitFor();
  await page.screenshot({ path: join(out, '6-pointed.png') });
  await page.mouse.move(640, 300);
  assert.equal(await page.locator('#overlay .mark').count(), 0);
  assert.match(await page.locator('.views button').first().getAttribute('title'), /° around, \d+° (up|below)$/);

  step('one light alone, one hidden: a look that changes no step');
  await page.locator('.step[data-node="3"]').click();
  await settled(page);
  const all = await look(page);
  const steps = await page.evaluate(() => JSON.stringify(window.lumi.session.nodes));
  await page.locator('[data-solo="2.0"]').click();
  await settled(page);
  const alone = await look(page);
  assert.ok(differ(alone, all) > 3, 'less light');
  assert.match(await page.locator('#shown').textContent(), /^1 of 3 lights shown/);
  await page.screenshot({ path: join(out, '6-solo.png') });
  await page.locator('[data-solo="2.0"]').click();
  await page.locator('[data-eye="2.0"]').click();
  await settled(page);
  const without = await look(page);
  assert.ok(differ(without, alone) > 3 && differ(without, all) > 0.5, 'the others');
  await page.screenshot({ path: join(out, '6-hidden.png') });
  await page.locator('#shown').click();
  await settled(page);
  assert.ok(differ(await look(page), all) < 1, 'all light is back');
  assert.equal(await page.evaluate(() => JSON.stringify(window.lumi.session.nodes)), steps, 'no step has changed');

  step('a name of a step, in the history and in the list');
  const name = page.locator('input.name');
  assert.equal(await name.inputValue(), 'Area 1');
  await name.fill('Window');
  await name.press('Escape');
  assert.equal(await name.inputValue(), 'Area 1');
  await name.fill('Window');
  await name.press('Enter');
  await settled(page);
  assert.equal(await page.locator('.step[data-node="3"] .caption').textContent(), '+ Window');
  assert.equal(await page.locator('.lit', { hasText: 'Window' }).count(), 1);
  assert.ok(differ(await look(page), all) < 1, 'the picture stays');
  await page.locator('.step[data-node="4"]').click();
  await settled(page);

  step('keys; a message leaves with its cause');
  await page.locator('#picture').focus();
  await page.keyboard.press('?');
  await page.waitForSelector('.keys');
  await page.screenshot({ path: join(out, '7-keys.png') });
  await page.keyboard.press('Escape');
  await page.evaluate(() => window.lumi.frames.socket.close());
  const lost = page.locator('.toast', { hasText: 'The connection is lost' });
  await lost.waitFor();
  await lost.waitFor({ state: 'detached' });
  await settled(page);

  step('remove a step, and bring it back');
  await page.locator('#delete').click();
  await settled(page);
  assert.equal(await nodes(page), 4);
  await page.locator('.toast button').click();
  await settled(page);
  assert.equal(await nodes(page), 5);
  await page.locator('.step[data-node="3"]').click();
  await settled(page);

  step('a spot and a sun: on the picture, in the list, by numbers');
  const unlit = await look(page);
  await page.locator('#picture').focus();
  await page.keyboard.press('4');
  await settled(page);
  assert.equal(await nodes(page), 6);
  assert.ok(differ(await look(page), unlit) > 1, 'the spot changes the picture');
  assert.equal(await page.locator('.light.active .cone').count(), 1);
  const aimed = await page.evaluate(() => window.lumi.edit().lights[0].target);
  const aim = await page.locator('.light.active .knob.aim circle').boundingBox();
  await page.mouse.move(aim.x + 8, aim.y + 8);
  await page.mouse.down();
  await page.mouse.move(aim.x + 40, aim.y - 20, { steps: 10 });
  await page.mouse.up();
  await settled(page);
  assert.notDeepEqual(await page.evaluate(() => window.lumi.edit().lights[0].target), aimed, 'dragging aims the spot');
  await type('Cone', '30');
  await settled(page);
  assert.equal((await light()).angle, 30);
  await type('Cone', '200');
  assert.match(await wrong.textContent(), /^Cone: expected 1 to 180 °/);
  await field('Cone').press('Escape');
  await page.screenshot({ path: join(out, '7-spot.png') });
  const spotlit = await look(page);
  await page.locator('[data-add=sun]').click();
  await settled(page);
  assert.ok(differ(await look(page), spotlit) > 1, 'the sun changes the picture');
  assert.equal(await page.locator('.light.active .tip').count(), 0, 'a sun has no place to move along');
  const shone = (await light()).from;
  const disc = await page.locator('.light.active .lamp .core').boundingBox();
  await page.mouse.move(disc.x + disc.width / 2, disc.y + disc.height / 2);
  await page.mouse.down();
  await page.mouse.move(disc.x - 60, disc.y + 30, { steps: 15 });
  await page.mouse.up();
  await settled(page);
  assert.notDeepEqual((await light()).from, shone, 'dragging turns the sun');
  await type('Height', '40');
  await type('Strength', '2.5');
  await settled(page);
  assert.equal((await light()).strength, 2.5);
  assert.deepEqual(await page.locator('.lit .row span').allTextContents().then((all) => all.slice(-2)), ['Spot 1', 'Sun 1']);
  await page.screenshot({ path: join(out, '7-sun.png') });
  const last = await head(page);

  step('export: PNG, EXR, turntable as animation and video, edits, session');
  await page.locator('#export').click();
  await page.waitForFunction(() => document.querySelector('.command pre').textContent.includes('lumi relight'));
  await page.screenshot({ path: join(out, '7-export.png') });
  const magic = { png: [0x89, 0x50], exr: [0x76, 0x2f], turntable: [0x47, 0x49], video: null, edits: [0x50, 0x4b], session: null };
  for (const [kind, bytes] of Object.entries(magic)) {
    const [download] = await Promise.all([page.waitForEvent('download', { timeout: 150_000 }), page.locator(`#get-${kind}`).click()]);
    const path = join(out, `export-${download.suggestedFilename()}`);
    await download.saveAs(path);
    assert.ok(statSync(path).size > (kind === 'video' ? 10_000 : 500), kind);
    if (bytes) assert.deepEqual([...readFileSync(path).subarray(0, 2)], bytes, kind);
  }

  step('the command line runs as it is printed, and sees what the page sees');
  const command = await page.locator('.command pre').textContent();
  const shell = spawnSync('sh', ['-c', command], { cwd: work, env: { ...process.env, PATH: `${dirname(resolve(program))}${delimiter}${process.env.PATH}` } });
  assert.equal(shell.status, 0, `${command}\n${shell.stderr}`);
  const [folder] = command.match(/--out (\S+)/).slice(1);
  writeFileSync(join(out, 'command.png'), readFileSync(join(work, folder, 'views', 'view.png')));
  writeFileSync(join(out, 'command.txt'), command);
  await page.keyboard.press('Escape');

  step('the server is restarted; the session is there');
  const session = await page.evaluate(() => window.lumi.session.id);
  const saved = await page.evaluate(() => window.lumi.session.nodes.map((n) => [n.id, n.parent, n.edit]));
  await settled(page);
  const from = await page.evaluate(() => window.lumi.stage.camera);
  const final = await look(page);
  const figures = await page.evaluate(() => ({ edits: window.lumi.metrics.edits, frames: window.lumi.metrics.frames.length }));
  assert.deepEqual(errors, []);
  await context.close();
  assert.equal(await server.stop(), 0);
  server = await start();
  const again = await open(1280, 720);
  await again.page.goto(`${server.url}`);
  await again.page.waitForSelector('body.ready');
  await again.page.locator('#open').click();
  await again.page.locator(`[data-session="${session}"]`).click();
  await again.page.waitForFunction((id) => window.lumi.session.id === id, session);
  await again.page.locator(`.step[data-node="${last}"]`).click();
  await again.page.evaluate((camera) => window.lumi.stage.glide(camera), from);
  await settled(again.page);
  assert.deepEqual(await again.page.evaluate(() => window.lumi.session.nodes.map((n) => [n.id, n.parent, n.edit])), saved);
  assert.ok(differ(await look(again.page), final) < 3, 'the same picture');

  step('upload a capture: what the check says, then encode');
  await again.page.locator('#open').click();
  await again.page.screenshot({ path: join(out, '8-open.png') });
  await again.page.locator('#pick-folder').setInputFiles(join(data, 'bundled', 'spot'));
  await again.page.waitForSelector('#encode');
  await again.page.waitForFunction(() => document.querySelector('.whole img').naturalWidth > 500);
  await again.page.waitForTimeout(300);
  await again.page.screenshot({ path: join(out, '9-check.png') });
  await again.page.locator('summary').click();
  await again.page.screenshot({ path: join(out, '9-check-whole.png'), fullPage: true });
  await again.page.locator('#encode').click();
  await again.page.waitForFunction((id) => window.lumi.session.id !== id && !document.querySelector('dialog').open, session);
  await settled(again.page);
  assert.equal(await nodes(again.page), 1);

  step('a broken upload says so, and the page goes on');
  const broken = join(work, 'broken');
  mkdirSync(broken);
  writeFileSync(join(broken, 'transforms.json'), '{"frames": [{"file_path": "../../secret.png"}]}');
  await again.page.locator('#open').click();
  await again.page.locator('#pick-folder').setInputFiles(broken);
  await again.page.waitForSelector('.error');
  assert.match(await again.page.locator('.error').textContent(), /inside the folder/);
  assert.deepEqual(again.errors.filter((e) => !/422/.test(e)), []);
  await again.context.close();

  step('on a phone');
  const phone = await open(390, 844, { hasTouch: true, isMobile: true, deviceScaleFactor: 2 });
  await phone.page.goto(`${server.url}#session=${session}`);
  await phone.page.waitForSelector('body.ready');
  await settled(phone.page);
  const wide = await phone.page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert.ok(wide <= 0, 'nothing is cut off at the side');
  await phone.page.screenshot({ path: join(out, '10-phone.png') });
  for (const dialog of ['open', 'keys', 'export']) {
    await phone.page.locator(`#${dialog}`).tap();
    await phone.page.waitForSelector('dialog[open] .sheet');
    await phone.page.waitForTimeout(400);
    const sheet = await phone.page.locator('.sheet').boundingBox();
    assert.ok(sheet.x >= 0 && sheet.x + sheet.width <= 390, `${dialog} fits`);
    const over = await phone.page.evaluate(() => { const s = document.querySelector('.sheet'); return s.scrollWidth - s.clientWidth; });
    assert.ok(over <= 0, `${dialog} is not cut off`);
    await phone.page.screenshot({ path: join(out, `10-phone-${dialog}.png`) });
    await phone.page.locator('.sheet [aria-label=Close]').tap();
  }
  await phone.page.locator('[data-add=point]').tap();
  await settled(phone.page);
  await phone.page.screenshot({ path: join(out, '11-phone-point.png') });
  const finger = await phone.context.newCDPSession(phone.page);
  const touch = (type, ...touchPoints) => finger.send('Input.dispatchTouchEvent', { type, touchPoints });
  const core = await phone.page.locator('.light.active .lamp .core').boundingBox();
  const [x, y] = [core.x + core.width / 2, core.y + core.height / 2];
  const place = () => phone.page.evaluate(() => window.lumi.edit().lights[0].position);
  const put = await place();
  await touch('touchStart', { x, y });
  for (let i = 1; i <= 12; i += 1) {
    await touch('touchMove', { x: x - 4 * i, y: y + 4 * i });
    await phone.page.waitForTimeout(16);
  }
  const half = await place();
  await touch('touchMove', { x: x - 80, y: y + 80 });
  await touch('touchEnd');
  await settled(phone.page);
  assert.notDeepEqual(half, put, 'a finger drags the light');
  assert.notDeepEqual(await place(), half, 'to where it is lifted');
  await phone.page.locator('[data-number="Position X"]').scrollIntoViewIfNeeded();
  await phone.page.locator('[data-number="Position X"]').tap();
  await phone.page.locator('[data-number="Position X"]').fill('0.1');
  await phone.page.locator('[data-number="Position Y"]').fill('0.1');
  await phone.page.locator('[data-number="Position Z"]').fill('0.1');
  await phone.page.keyboard.press('Enter');
  assert.match(await phone.page.locator('.panel .wrong:visible').textContent(), /^Position: expected a place/);
  await phone.page.screenshot({ path: join(out, '12-phone-numbers.png') });
  await phone.page.keyboard.press('Escape');
  await phone.page.locator('.panel .eye:enabled').first().scrollIntoViewIfNeeded();
  await phone.page.locator('.panel .eye:enabled').first().tap();
  await settled(phone.page);
  await phone.page.screenshot({ path: join(out, '13-phone-lights.png') });
  await phone.page.locator('#shown').tap();
  await phone.page.locator('[data-add=environment]').tap();
  await phone.page.locator('.toast', { hasText: 'replaces all light' }).waitFor();
  await settled(phone.page);
  await phone.page.screenshot({ path: join(out, '14-phone-replaced.png') });
  await phone.page.locator('.toast button').tap();
  await settled(phone.page);
  await phone.page.locator('#photograph').tap();
  await phone.page.waitForFunction(() => window.lumi.photograph.shown);
  await settled(phone.page);
  await phone.page.screenshot({ path: join(out, '15-phone-photograph.png') });
  await phone.page.locator('#photograph').tap();
  await phone.page.locator('[data-add=spot]').tap();
  await settled(phone.page);
  await phone.page.screenshot({ path: join(out, '16-phone-spot.png') });
  await phone.page.locator('[data-add=sun]').tap();
  await settled(phone.page);
  assert.equal(await phone.page.evaluate(() => document.documentElement.scrollWidth - innerWidth), 0);
  await phone.page.screenshot({ path: join(out, '17-phone-sun.png') });
  assert.deepEqual(phone.errors, []);

  const rate = 1000 / median(intervals);
  const report = { orbit_fps_median: +rate.toFixed(1), orbit_frames: frames.length, orbit_full_frames: orbit.filter((f) => f.quality === 'full').length, edit_ms_median: +median(figures.edits).toFixed(0), edits: figures.edits.length };
  writeFileSync(join(out, 'figures.json'), JSON.stringify(report));
  console.log(JSON.stringify(report));
} finally {
  await browser.close();
  await server.stop();
  rmSync(work, { recursive: true, force: true });
}
