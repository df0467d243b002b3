/** The WebSocket: reconnects, notices that nothing comes, and rests while nobody looks. */

const STALE = 1500; // ms without a message
const UNSEEN = 10000; // ms that a hidden page goes on
const LONGEST = 5000; // ms between two attempts

export class Link {
  /** `onMessage` is called with each message, `onState` with good, wait or bad and a few words. */
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    this.wait = 500;
    this.newest = 0;
    setInterval(() => this.look(), 250);
    document.addEventListener("visibilitychange", () => this.onVisible());
    this.connect();
  }

  connect() {
    clearTimeout(this.timer);
    const address = new URL("live", location.href);
    address.protocol = address.protocol.replace("http", "ws");
    address.search = address.hash = "";
    const socket = (this.socket = new WebSocket(address));
    socket.onmessage = (event) => {
      if (this.socket !== socket) return;
      this.newest = performance.now();
      this.wait = 500;
      const message = JSON.parse(event.data);
      this.stalled = "stalled" in message;
      this.onMessage(message);
      this.look();
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      this.look();
      if (document.hidden) return;
      this.timer = setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(1.6 * this.wait, LONGEST);
    };
  }

  look() {
    const silent = this.newest ? performance.now() - this.newest : Infinity;
    const since = this.newest ? `, nothing for ${Math.round(silent / 1000)} s` : "";
    if (!this.socket) this.onState("bad", `no connection${since}: trying again`);
    else if (this.stalled) this.onState("bad", "the daemon's loop is stalled");
    else if (!this.newest) this.onState("wait", "connecting");
    else if (silent > STALE) this.onState("bad", `stale${since}`);
    else this.onState("good", "live");
  }

  onVisible() {
    clearTimeout(this.hiding);
    if (document.hidden) {
      this.hiding = setTimeout(() => this.socket?.close(), UNSEEN);
    } else if (!this.socket) {
      this.connect();
    }
  }
}
