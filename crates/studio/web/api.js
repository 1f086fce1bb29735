// Requests to the server: HTTP as in /api/openapi.json, frames over a WebSocket as in docs/studio.md.

export async function call(method, path, body) {
  const options = { method, headers: {} };
  if (body instanceof Blob || body instanceof FormData) {
    options.body = body;
  } else if (body !== undefined) {
    options.body = JSON.stringify(body);
    options.headers['content-type'] = 'application/json';
  }
  let response;
  try {
    response = await fetch(path, options);
  } catch {
    throw new Error('The studio does not answer. Is it still running?');
  }
  const text = await response.text();
  let json = {};
  try {
    json = JSON.parse(text);
  } catch {
    // Errors of the transport are no JSON.
  }
  if (!response.ok) {
    const error = new Error(json.error || `${response.status} ${response.statusText}`);
    error.status = response.status;
    throw error;
  }
  return json;
}

export const get = (path) => call('GET', path);
export const post = (path, body) => call('POST', path, body);
export const put = (path, body) => call('PUT', path, body);
export const remove = (path) => call('DELETE', path);

// Frames of one session. At most two requests are on their way; while they are, only the newest one waits.
export class Frames {
  constructor(session, handlers) {
    this.url = `${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/api/sessions/${session}/socket`;
    this.handlers = handlers;
    this.id = 0;
    this.sent = new Map();
    this.waiting = null;
    this.closed = false;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(this.url);
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => {
      this.sent.clear();
      this.handlers.open();
    };
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = () => {
      if (this.closed) return;
      this.handlers.lost();
      setTimeout(() => !this.closed && this.connect(), 1000);
    };
    this.socket = socket;
  }

  close() {
    this.closed = true;
    this.socket.close();
  }

  ask(request) {
    this.waiting = { request, since: performance.now() };
    this.pump();
  }

  pump() {
    if (!this.waiting || this.sent.size >= 2 || this.socket.readyState !== WebSocket.OPEN) return;
    const { request, since } = this.waiting;
    this.waiting = null;
    this.id += 1;
    this.sent.set(this.id, { since, request });
    this.socket.send(JSON.stringify({ ...request, id: this.id }));
  }

  // An answer to a request also settles the older ones: the server has dropped them.
  settle(id, keep) {
    const asked = this.sent.get(id);
    for (const older of [...this.sent.keys()]) {
      if (older < id || (older === id && !keep)) this.sent.delete(older);
    }
    this.pump();
    return asked;
  }

  receive(data) {
    if (typeof data === 'string') {
      const message = JSON.parse(data);
      if (message.type === 'changed') this.handlers.changed(message.revision);
      if (message.type === 'error') {
        this.settle(message.id ?? this.id);
        this.handlers.error(message.error);
      }
      return;
    }
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const size = header.width * header.height * 4;
    const panes = [];
    for (let i = 0; i < header.panes; i += 1) panes.push(new Uint8Array(data, 4 + length + i * size, size));
    const asked = this.sent.get(header.id);
    const more = header.quality === 'quick' && asked && !asked.request.moving;
    this.settle(header.id, more);
    this.handlers.frame(header, panes, asked);
  }
}
