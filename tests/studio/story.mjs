// The whole story in headless Chromium: open, load, orbit, three lights, undo, branch, compare, export, and the
// saved session after a restart of the server.
//
//   node story.mjs LUMI OUT     LUMI: the program; OUT: a folder for screenshots and figures
//
// Needs playwright-core (NODE_PATH or node_modules) and a Chromium (CHROMIUM, default chromium).

import { spawn } from 'node:child_process';
import { mkdirSync, mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
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
  await page.locator('.map').nth(1).click();
  await settled(page);
  assert.equal(await nodes(page), 2, 'another map changes the step, it adds none');
  await page.screenshot({ path: join(out, '2-environment.png') });
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

  step('remove a step, and bring it back');
  await page.locator('#delete').click();
  await settled(page);
  assert.equal(await nodes(page), 4);
  await page.locator('.toast button').click();
  await settled(page);
  assert.equal(await nodes(page), 5);
  await page.locator('.step[data-node="3"]').click();
  await settled(page);

  step('export: PNG, EXR, turntable as animation and video, edits, session');
  await page.locator('#export').click();
  await page.waitForFunction(() => document.querySelector('.command pre').textContent.startsWith('lumi relight'));
  await page.screenshot({ path: join(out, '7-export.png') });
  const magic = { png: [0x89, 0x50], exr: [0x76, 0x2f], turntable: [0x47, 0x49], video: null, edits: [0x50, 0x4b], session: null };
  for (const [kind, bytes] of Object.entries(magic)) {
    const [download] = await Promise.all([page.waitForEvent('download', { timeout: 60_000 }), page.locator(`#get-${kind}`).click()]);
    const path = join(out, `export-${download.suggestedFilename()}`);
    await download.saveAs(path);
    assert.ok(statSync(path).size > (kind === 'video' ? 10_000 : 500), kind);
    if (bytes) assert.deepEqual([...readFileSync(path).subarray(0, 2)], bytes, kind);
  }
  await page.keyboard.press('Escape');

  step('the server is restarted; the session is there');
  const session = await page.evaluate(() => window.lumi.session.id);
  const saved = await page.evaluate(() => window.lumi.session.nodes.map((n) => [n.id, n.parent, n.edit]));
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
  await again.page.locator('.step[data-node="3"]').click();
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
