// A turntable as a video file. The server draws the frames; the browser, which has the encoders, packs them.

// Best first: what most players open, then what every Chromium and Firefox can write.
const KINDS = [
  ['video/mp4;codecs=avc1.42E01F', 'mp4'],
  ['video/webm;codecs=vp9', 'webm'],
  ['video/webm;codecs=vp8', 'webm'],
];
const RATE = 30;

export const kind = () => globalThis.MediaRecorder && KINDS.find(([mime]) => MediaRecorder.isTypeSupported(mime));

// Once around at 30 frames a second: `address(i / frames)` is the picture at that share of the turn. `told` hears the
// share that is done. Recording takes as long as the video, since the recorder stamps frames with the time of day.
export async function record(address, { frames = 120, side = 720, told = () => {} } = {}) {
  const [mimeType, extension] = kind();
  const pictures = [];
  // A few at a time keep the server busy without making others wait.
  for (let first = 0; first < frames; first += 4) {
    const some = Array.from({ length: Math.min(4, frames - first) }, (_, i) => load(address((first + i) / frames)));
    pictures.push(...await Promise.all(some));
    told((0.6 * pictures.length) / frames);
  }
  const canvas = Object.assign(document.createElement('canvas'), { width: side, height: side });
  const context = canvas.getContext('2d', { alpha: false });
  context.imageSmoothingQuality = 'high';
  const draw = (i) => context.drawImage(pictures[i], 0, 0, side, side);
  draw(0);
  const recorder = new MediaRecorder(canvas.captureStream(RATE), { mimeType, videoBitsPerSecond: 8e6 });
  const parts = [];
  recorder.ondataavailable = (event) => parts.push(event.data);
  const finished = new Promise((done, bad) => {
    recorder.onstop = done;
    recorder.onerror = (event) => bad(event.error ?? new Error('the browser could not encode the video'));
  });
  recorder.start();
  const began = performance.now();
  // By the clock, not by counting ticks: a slow tick drops a frame and keeps the speed.
  for (let at = 0; at < frames; at = Math.floor(((performance.now() - began) * RATE) / 1000)) {
    draw(at);
    told(0.6 + (0.4 * at) / frames);
    await new Promise((done) => { setTimeout(done, 1000 / RATE / 2); });
  }
  recorder.stop();
  await finished;
  pictures.forEach((p) => p.close());
  return { blob: new Blob(parts, { type: mimeType.split(';')[0] }), extension };
}

async function load(address) {
  const response = await fetch(address);
  if (!response.ok) throw new Error((await response.json().catch(() => ({}))).error ?? `${response.status} ${response.statusText}`);
  return createImageBitmap(await response.blob());
}
