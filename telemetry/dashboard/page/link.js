// The connection to the server: opens, notices when nothing comes, opens again.
const STALE_MS = 1000; // twenty messages that did not come
const LOST_MS = 4000; // as long, and the connection is given up
const RETRY_MS = 700;
const LOOK_MS = 200;

export class Link {
  constructor(on) {
    this.on = on;
    this.wasOpen = false;
    this.newest = -Infinity;
    this.plots = null;
    setInterval(() => this.look(), LOOK_MS);
    addEventListener("hashchange", () => this.takeToken());
    this.takeToken();
  }

  // The token comes behind the address's #, which no server sees, and leaves the address at once.
  takeToken() {
    const given = new URLSearchParams(location.hash.slice(1)).get("token");
    if (!given) return;
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
    this.showToken(given);
  }

  get isFresh() {
    return performance.now() - this.newest < STALE_MS;
  }

  get silentText() {
    return `${((performance.now() - this.newest) / 1000).toFixed(0)} s`;
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/bus`);
    this.socket = socket;
    this.openedAt = performance.now();
    socket.onopen = () => {
      const token = sessionStorage.getItem("token");
      if (token) this.showToken(token);
      if (this.plots) this.send({ do: "plot", signals: this.plots });
    };
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      setTimeout(() => this.socket ?? this.open(), RETRY_MS);
    };
  }

  take(message) {
    if (message.hello) this.on.onHello(message.hello);
    if ("control" in message) this.on.onControl(message.control);
    if (message.refused) this.on.onRefused(message.refused);
    if (!message.news) return;
    this.wasOpen = true;
    this.newest = performance.now();
    this.on.onNews(message);
  }

  // A connection over which nothing comes may be dead without telling: a phone changed its network.
  look() {
    const silent = performance.now() - Math.max(this.newest, this.openedAt ?? 0);
    if (this.socket && silent > LOST_MS) {
      const dead = this.socket;
      this.socket = null;
      dead.close();
      this.open();
    }
    this.on.onState(this);
  }

  send(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  showToken(token) {
    sessionStorage.setItem("token", token);
    this.send({ do: "show_token", token });
  }

  plot(signals) {
    this.plots = signals;
    this.send({ do: "plot", signals });
  }
}
