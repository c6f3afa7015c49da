// Buttons, the pad to drive with, the pedals. What is held is repeated; the server lets go of it
// when it is not.
const REPEAT_MS = 100;
const REFUSED_MS = 6000;
const at = (id) => document.getElementById(id);

export class Controls {
  constructor(link) {
    this.link = link;
    this.hello = { actions: [], limits: {} };
    this.mayControl = false;
    this.isFresh = false;
    this.held = null;
    for (const button of document.querySelectorAll("[data-action]")) {
      button.addEventListener("click", () => this.act(button.dataset.action));
    }
    for (const button of document.querySelectorAll("[data-hold]")) this.holdButton(button);
    this.pad();
    at("token-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.link.showToken(at("token").value);
      at("token").value = "";
    });
    setInterval(() => this.repeat(), REPEAT_MS);
    for (const name of ["blur", "pagehide"]) addEventListener(name, () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
  }

  offer(hello) {
    this.hello = hello;
    this.mayControl = false;
    for (const button of document.querySelectorAll("#actions [data-action]")) {
      button.hidden = !hello.actions.includes(button.dataset.action);
    }
    at("drive").hidden = !hello.limits.speed_mps;
    at("driver").hidden = !hello.limits.pedal_ratio;
    this.enable();
  }

  grant(isGranted) {
    this.mayControl = isGranted;
    if (!isGranted) {
      sessionStorage.removeItem("token");
      this.refuse("wrong token: watching only");
    }
    this.enable();
  }

  setFresh(isFresh) {
    if (this.isFresh === isFresh) return;
    this.isFresh = isFresh;
    if (!isFresh) this.release();
    this.enable();
  }

  show(values) {
    if (this.mode === values.mode) return;
    this.mode = values.mode;
    this.enable();
  }

  enable() {
    const may = this.mayControl && this.isFresh;
    const fits = {
      engage: this.mode === "READY",
      disengage: this.mode === "AUTOMATIC",
      reset: this.mode === "EMERGENCY" || this.mode === "MANUAL",
    };
    for (const button of document.querySelectorAll("[data-action]")) {
      button.disabled = !may || fits[button.dataset.action] === false;
    }
    for (const button of document.querySelectorAll("[data-hold]")) button.disabled = !may;
    at("pad").classList.toggle("off", !may);
    at("token-form").hidden = this.mayControl;
    at("emergency-note").textContent = this.mayControl ? "" : "needs the token";
  }

  act(action) {
    if (!this.link.send({ do: action })) this.refuse("no connection: not sent");
  }

  refuse(text) {
    const note = at("refused");
    note.textContent = text;
    note.hidden = false;
    clearTimeout(this.refusedTimer);
    this.refusedTimer = setTimeout(() => { note.hidden = true; }, REFUSED_MS);
  }

  hold(wish) {
    if (!this.mayControl || !this.isFresh) return;
    this.held = wish;
    this.repeat();
  }

  repeat() {
    if (this.held) this.link.send({ do: "hold", ...this.held });
  }

  release() {
    if (!this.held) return;
    this.held = null;
    this.link.send({ do: "release" });
    for (const item of document.querySelectorAll(".held")) item.classList.remove("held");
    this.knob(0, 0);
  }

  holdButton(button) {
    const wish = JSON.parse(button.dataset.hold);
    button.addEventListener("pointerdown", (event) => {
      if (button.disabled) return;
      button.setPointerCapture(event.pointerId);
      button.classList.add("held");
      this.hold(wish);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      button.addEventListener(name, () => this.release());
    }
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  // Up is speed, sideways is steering. Positive curvature turns left.
  pad() {
    const pad = at("pad");
    const take = (event) => {
      const box = pad.getBoundingClientRect();
      const side = Math.max(-1, Math.min(1, (2 * (event.clientX - box.left)) / box.width - 1));
      const up = Math.max(0, Math.min(1, (box.bottom - 24 - event.clientY) / (box.height - 48)));
      this.wish(side, up);
    };
    pad.addEventListener("pointerdown", (event) => {
      if (!this.mayControl) return;
      pad.setPointerCapture(event.pointerId);
      pad.classList.add("held");
      take(event);
    });
    pad.addEventListener("pointermove", (event) => this.held && pad.hasPointerCapture(event.pointerId) && take(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      pad.addEventListener(name, () => this.release());
    }
    const keys = new Set();
    const steer = () => {
      const side = keys.has("ArrowRight") - keys.has("ArrowLeft");
      if (keys.size) this.wish(0.5 * side, keys.has("ArrowUp") ? 0.4 : 0);
      else this.release();
    };
    pad.addEventListener("keydown", (event) => {
      if (!event.key.startsWith("Arrow")) return;
      event.preventDefault();
      keys.add(event.key);
      steer();
    });
    pad.addEventListener("keyup", (event) => { if (keys.delete(event.key)) steer(); });
    pad.addEventListener("blur", () => { keys.clear(); this.release(); });
  }

  wish(side, up) {
    const { speed_mps, curvature_per_m } = this.hello.limits;
    const wish = { speed_mps: up * speed_mps, curvature_per_m: -Math.sign(side) * side * side * curvature_per_m };
    this.hold(wish);
    if (!this.held) return;
    this.knob(side, up);
    at("pad-text").textContent = `${(3.6 * wish.speed_mps).toFixed(1)} km/h, `
      + (Math.abs(wish.curvature_per_m) < 0.002 ? "straight" : `radius ${(1 / Math.abs(wish.curvature_per_m)).toFixed(0)} m`);
  }

  knob(side, up) {
    const pad = at("pad");
    const knob = at("pad-knob");
    knob.style.left = `${50 + 50 * side}%`;
    knob.style.bottom = `${24 + up * (pad.clientHeight - 48)}px`;
    if (!this.held) at("pad-text").textContent = "";
  }
}
