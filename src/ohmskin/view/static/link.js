// The socket to the page's server: reconnects by itself, keeps only the newest frame.

const FIRST_WAIT = 300; // ms
const LONGEST_WAIT = 5000;

/** A binary message as { header, base, image }. */
export function readFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const values = new Float32Array(buffer, 4 + length);
  const half = values.length / 2;
  return { header, base: values.subarray(0, half), image: values.subarray(half) };
}

/** Calls onStarting(message), onSetup(setup), onFrame(frame), onOpen(), onLost() and onRefused(message). */
export class Link {
  constructor(handlers) {
    this._handlers = handlers;
    this._wait = FIRST_WAIT;
    this._open();
  }

  get connected() {
    return this._socket.readyState === WebSocket.OPEN;
  }

  send(command) {
    if (this.connected) this._socket.send(JSON.stringify(command));
  }

  _open() {
    const address = new URL("socket", location.href);
    address.protocol = address.protocol.replace("http", "ws");
    address.search = location.search;
    address.hash = "";
    this._socket = new WebSocket(address);
    this._socket.binaryType = "arraybuffer";
    this._socket.onmessage = (event) => this._hear(event.data);
    this._socket.onopen = () => this._handlers.onOpen();
    this._socket.onclose = () => {
      this._handlers.onLost();
      setTimeout(() => this._open(), this._wait);
      this._wait = Math.min(LONGEST_WAIT, 1.7 * this._wait);
    };
  }

  _hear(data) {
    this._wait = FIRST_WAIT;
    if (typeof data !== "string") {
      this._handlers.onFrame(readFrame(data));
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "starting") this._handlers.onStarting(message);
    else if (message.type === "setup") this._handlers.onSetup(message);
    else if (message.type === "refused") this._handlers.onRefused(message.message);
  }
}
