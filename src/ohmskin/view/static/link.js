// Sockets to the page's server, and what their binary messages hold; that of the live page reconnects by itself.

const FIRST_WAIT = 300; // ms
const LONGEST_WAIT = 5000;

/** A socket to the server of this page. */
export function openSocket() {
  const address = new URL("socket", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  address.search = location.search;
  const socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  return socket;
}

/** The same, told of in #state; `again` is called a second after it has closed. */
export function openShownSocket(again) {
  const [socket, state] = [openSocket(), document.getElementById("state")];
  socket.addEventListener("open", () => {
    [state.dataset.state, state.textContent] = ["running", "connected"];
  });
  socket.addEventListener("close", () => {
    [state.dataset.state, state.textContent] = ["lost", "no connection"];
    setTimeout(again, 1000);
  });
  return socket;
}

/** The header of a binary message, and where its numbers begin. */
export function readHeader(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  return [JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length))), 4 + length];
}

/** A binary message as { header, base, image }. */
export function readFrame(buffer) {
  const [header, at] = readHeader(buffer);
  const values = new Float32Array(buffer, at);
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
    this._socket = openSocket();
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
