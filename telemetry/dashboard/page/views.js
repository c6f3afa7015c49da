// Instruments: speed, steering wheel, pedals, mode, nodes, codes, bus, events.
const at = (id) => document.getElementById(id);
const DASH = "–";
const KMH_PER_MPS = 3.6;
const DIAL = { x: 120, y: 110, r: 92, from: -225, span: 270 };
const LINES_MAX = 300;
let dialMax = 0;

function arc(ratio) {
  const point = (degrees) => {
    const turn = (degrees * Math.PI) / 180;
    return `${DIAL.x + DIAL.r * Math.cos(turn)} ${DIAL.y + DIAL.r * Math.sin(turn)}`;
  };
  const end = DIAL.from + DIAL.span * Math.min(Math.max(ratio, 0.0001), 1);
  const isLarge = end - DIAL.from > 180 ? 1 : 0;
  return `M${point(DIAL.from)} A${DIAL.r} ${DIAL.r} 0 ${isLarge} 1 ${point(end)}`;
}

export function showCar(values) {
  showSpeed(values);
  const degrees = (rad) => (rad == null ? null : (rad * 180) / Math.PI);
  const wheel = degrees(values.wheel_rad);
  const setpoint = degrees(values.wheel_setpoint_rad);
  at("wheel-turn").setAttribute("transform", `rotate(${-(wheel ?? 0)})`);
  at("wheel-turn").setAttribute("opacity", wheel == null ? 0.2 : 1);
  at("wheel-setpoint").setAttribute("transform", `rotate(${-(setpoint ?? 0)})`);
  at("wheel-setpoint").setAttribute("opacity", setpoint == null ? 0 : 1);
  at("wheel-text").textContent = wheel == null ? DASH : turned(wheel);
  bar("throttle", values.throttle_pedal_ratio);
  bar("brake", values.brake_pedal_ratio);
  bar("servo", values.servo_ratio);
  at("mode").textContent = values.mode ?? "NOT HEARD";
  at("mode").dataset.mode = values.mode ?? "";
  const why = values.why ?? "";
  if (at("why").textContent !== why) at("why").textContent = why;
}

function turned(degrees) {
  const whole = Math.round(degrees);
  return whole === 0 ? "0°" : `${Math.abs(whole)}° ${whole > 0 ? "left" : "right"}`;
}

function showSpeed(values) {
  const most = (values.hello?.speed_mps_max ?? 10) * KMH_PER_MPS;
  if (most !== dialMax) {
    dialMax = most;
    at("dial-track").setAttribute("d", arc(1));
  }
  const speed = values.speed_mps == null ? null : Math.abs(values.speed_mps) * KMH_PER_MPS;
  at("speed").textContent = speed == null ? DASH : speed.toFixed(speed < 9.95 ? 1 : 0);
  at("dial-value").setAttribute("d", speed ? arc(speed / most) : "");
  const setpoint = values.speed_setpoint_mps;
  const line = at("dial-setpoint");
  line.style.display = setpoint == null ? "none" : "";
  at("speed-setpoint").textContent = setpoint == null ? "" : `set ${(setpoint * KMH_PER_MPS).toFixed(1)}`;
  if (setpoint == null) return;
  const turn = ((DIAL.from + DIAL.span * Math.min((setpoint * KMH_PER_MPS) / most, 1)) * Math.PI) / 180;
  const ends = { 1: DIAL.r - 12, 2: DIAL.r + 12 };
  for (const [name, radius] of Object.entries(ends)) {
    line.setAttribute(`x${name}`, DIAL.x + radius * Math.cos(turn));
    line.setAttribute(`y${name}`, DIAL.y + radius * Math.sin(turn));
  }
}

function bar(name, ratio) {
  at(`bar-${name}`).style.width = `${100 * Math.min(Math.max(ratio ?? 0, 0), 1)}%`;
  at(name).textContent = ratio == null ? DASH : `${Math.round(100 * ratio)} %`;
}

export function showHealth(values) {
  at("nodes").replaceChildren(...(values.nodes ?? []).map(nodeItem));
  const codes = values.codes;
  const none = element("li", codes == null ? "not heard" : "none", "quiet");
  at("codes").replaceChildren(...(codes?.length ? codes.map(codeItem) : [none]));
  const percent = (ratio) => `${(100 * (ratio ?? 0)).toFixed(1)} %`;
  at("load-bar").style.width = `${100 * Math.min(values.load ?? 0, 1)}%`;
  at("load-max").style.left = `${100 * Math.min(values.load_max ?? 0, 0.995)}%`;
  const parts = [
    `${percent(values.load)} load, most ${percent(values.load_max)}`,
    `${values.frames_per_s ?? 0} frames/s`,
  ];
  if (values.bad_frames) parts.push(`${values.bad_frames} bad frames`);
  if (values.error_frames) parts.push(`${values.error_frames} error frames`);
  if (values.verdict) parts.push(`verdict ${values.verdict}`);
  at("load").textContent = parts.join(" · ");
}

function nodeItem(node) {
  const item = element("li");
  item.dataset.is = node.presence;
  item.dataset.node = node.name;
  const trouble = [...node.missing, ...node.late];
  let text = [node.state || node.nmt, ...node.codes].filter(Boolean).join(" ");
  if (node.presence === "missing") text = "not heard";
  else if (trouble.length) text = `${node.missing.length ? "missing" : "late"} ${trouble.join(", ")}`;
  item.append(element("span", node.name), element("small", text));
  return item;
}

function codeItem(code) {
  const item = element("li");
  const since = element("span", ` since ${timeText(code.since)}`, "quiet");
  item.append(element("b", code.code), element("span", code.text || "latched"), since);
  return item;
}

export function addLines(lines) {
  const log = at("log");
  for (const line of lines) {
    const item = element("li");
    item.dataset.kind = line.kind;
    item.append(element("time", timeText(line.at)), element("span", line.text));
    log.prepend(item);
  }
  while (log.children.length > LINES_MAX) log.lastChild.remove();
}

function timeText(seconds) {
  const time = new Date(1000 * seconds);
  const two = (number) => String(number).padStart(2, "0");
  const ms = String(time.getMilliseconds()).padStart(3, "0");
  return `${two(time.getHours())}:${two(time.getMinutes())}:${two(time.getSeconds())}.${ms}`;
}

function element(tag, text = "", kind = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}
