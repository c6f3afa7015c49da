// Live plots of chosen signals: a minute each, drawn by uPlot.
/* global uPlot */
const SPAN_S = 60;
const SAMPLES_MAX = 1400;
const PLOTS_MAX = 8;
const DRAW_MS = 100;
const FIRST = [
  "STEER_STATUS.steering_wheel_angle_rad",
  "THROTTLE_STATUS.wheel_speed_radps",
  "BRAKE_STATUS.servo_position_ratio",
];
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);

export class Plots {
  constructor(link) {
    this.link = link;
    this.box = document.getElementById("plots");
    this.select = document.getElementById("signal");
    this.plots = [];
    this.select.addEventListener("change", () => {
      if (this.select.value) this.add(this.select.value);
      this.select.value = "";
    });
    setInterval(() => this.draw(), DRAW_MS);
    new ResizeObserver(() => this.fit()).observe(this.box);
  }

  offer(signals) {
    const first = new Option("add a signal …", "");
    this.select.replaceChildren(first, ...Object.keys(signals).map((name) => new Option(name, name)));
    this.units = signals;
    if (!this.plots.length) {
      const kept = JSON.parse(localStorage.getItem("plots") ?? "null") ?? FIRST;
      for (const name of kept.filter((name) => name in signals)) this.add(name);
    }
  }

  names() {
    return this.plots.map((plot) => plot.name);
  }

  add(name) {
    if (this.names().includes(name) || this.plots.length >= PLOTS_MAX) return;
    const plot = { name, times: [], values: [], node: document.createElement("div"), isNew: false };
    plot.node.className = "plot";
    plot.node.dataset.signal = name;
    const head = document.createElement("header");
    const title = document.createElement("span");
    title.title = title.textContent = name;
    plot.value = document.createElement("b");
    const close = document.createElement("button");
    close.className = "plain";
    close.textContent = "×";
    close.setAttribute("aria-label", `remove ${name}`);
    close.addEventListener("click", () => this.remove(plot));
    head.append(title, plot.value, close);
    plot.node.append(head);
    this.box.append(plot.node);
    this.plots.push(plot);
    this.make(plot);
    this.tell();
  }

  remove(plot) {
    plot.chart.destroy();
    plot.node.remove();
    this.plots = this.plots.filter((other) => other !== plot);
    this.tell();
  }

  tell() {
    localStorage.setItem("plots", JSON.stringify(this.names()));
    this.link.plot(this.names());
  }

  make(plot) {
    const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    plot.chart = new uPlot({
      width: Math.max(plot.node.clientWidth, 120),
      height: 120,
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false, range: () => this.span(plot) } },
      axes: [
        { ...axis, size: 20, values: (_, ticks) => ticks.map((t) => `${Math.round(t - this.now)} s`) },
        { ...axis, size: 48 },
      ],
      series: [{}, { stroke: colour("--accent"), width: 2, spanGaps: false }],
    }, [plot.times, plot.values], plot.node);
  }

  span() {
    return [(this.now ?? 0) - SPAN_S, this.now ?? 0];
  }

  take(time, values) {
    if (this.now && time < this.now) for (const plot of this.plots) { plot.times.length = plot.values.length = 0; }
    this.now = time;
    if (!values || values.length !== this.plots.length) return;
    this.plots.forEach((plot, place) => {
      plot.times.push(time);
      plot.values.push(values[place]);
      plot.isNew = true;
      const old = plot.times.findIndex((t) => t >= time - SPAN_S);
      const drop = Math.max(old, plot.times.length - SAMPLES_MAX);
      if (drop > 0) { plot.times.splice(0, drop); plot.values.splice(0, drop); }
    });
  }

  draw() {
    for (const plot of this.plots) {
      if (!plot.isNew) continue;
      plot.isNew = false;
      const value = plot.values[plot.values.length - 1];
      const unit = this.units?.[plot.name] ?? "";
      plot.value.textContent = value == null ? "–" : `${Number(value.toPrecision(4))} ${unit}`;
      plot.chart.setData([plot.times, plot.values]);
    }
  }

  fit() {
    for (const plot of this.plots) {
      if (plot.node.clientWidth !== plot.chart.width) plot.chart.setSize({ width: plot.node.clientWidth, height: 120 });
    }
  }

  redraw() {
    for (const plot of this.plots) { plot.chart.destroy(); this.make(plot); }
  }
}
