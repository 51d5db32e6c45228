// The live connection to the console: frames and states in, commands and acknowledgements out.
// A connection that ends is made anew; a command whose answer is then lost is answered "not known".

const ACK_EVERY = 5;
const RETRY_MS = 300;

export class Link {
  constructor(handlers, opened) {
    this.handlers = handlers; // {frame(header, columns), state, guard, event, ...}
    this.opened = opened; // called with each new connection
    this.asked = new Map();
    this.number = 0;
    this.taken = 0;
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}/live`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.opened();
    this.socket.onmessage = (message) => this.take(message.data);
    this.socket.onclose = () => {
      for (const done of this.asked.values()) {
        done({ ok: false, text: "the connection was lost; whether it was done is not known" });
      }
      this.asked.clear();
      this.taken = 0;
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  // A promise of {ok, text, ...}; never rejected.
  ask(cmd, fields = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ ok: false, text: `${cmd}: not sent, the page's server does not answer` });
    }
    this.number += 1;
    this.socket.send(JSON.stringify({ ask: this.number, cmd, ...fields }));
    return new Promise((done) => this.asked.set(this.number, done));
  }

  take(data) {
    if (typeof data !== "string") {
      this.acknowledge();
      this.handlers.frame(...decoded(data));
      return;
    }
    const message = JSON.parse(data);
    if (message.kind === "reply") {
      this.asked.get(message.ask)?.(message);
      this.asked.delete(message.ask);
    } else {
      this.handlers[message.kind]?.(message.told);
    }
  }

  acknowledge() {
    this.taken += 1;
    if (this.taken >= ACK_EVERY) {
      this.socket.send(JSON.stringify({ ack: this.taken }));
      this.taken = 0;
    }
  }
}

// [header, {name: Float64Array}] of a frame; see hapticd/console/watch.py.
function decoded(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const columns = {};
  header.columns.forEach((name, place) => {
    columns[name] = new Float64Array(buffer, 4 + length + 8 * header.n * place, header.n);
  });
  return [header, columns];
}
