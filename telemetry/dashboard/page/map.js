// The driven path from above: the whole of it, or the car in the middle.
const POINTS_MAX = 4000;
const FOLLOW_M = 60;
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);

export class Map {
  constructor(canvas) {
    this.canvas = canvas;
    this.clear();
    this.isFollowing = false;
    this.button = document.getElementById("map-fit");
    this.button.addEventListener("click", () => {
      this.isFollowing = !this.isFollowing;
      this.button.textContent = this.isFollowing ? "whole path" : "follow";
      this.draw();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  clear() {
    this.points = [];
    this.pose = [0, 0, 0];
  }

  take(path, values) {
    this.points.push(...path);
    if (this.points.length > POINTS_MAX) this.points.splice(0, this.points.length - POINTS_MAX);
    const pose = [values.x_m ?? 0, values.y_m ?? 0, values.heading_rad ?? 0];
    const isSame = path.length === 0 && pose.every((value, place) => value === this.pose[place]);
    this.pose = pose;
    document.getElementById("driven").textContent = `${(values.driven_m ?? 0).toFixed(0)} m driven`;
    if (!isSame) this.draw();
  }

  // Metres to pixels: x to the right, y up.
  view(width, height) {
    const [x, y] = this.pose;
    if (this.isFollowing) {
      return { scale: Math.min(width, height) / FOLLOW_M, middle: [x, y] };
    }
    let [left, right, low, high] = [x, x, y, y];
    for (const [px, py] of this.points) {
      left = Math.min(left, px); right = Math.max(right, px);
      low = Math.min(low, py); high = Math.max(high, py);
    }
    const margin = 8;
    const scale = Math.min(width / (right - left + 2 * margin), height / (high - low + 2 * margin));
    return { scale, middle: [(left + right) / 2, (low + high) / 2] };
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const dense = devicePixelRatio || 1;
    if (this.canvas.width !== width * dense || this.canvas.height !== height * dense) {
      this.canvas.width = width * dense;
      this.canvas.height = height * dense;
    }
    const pen = this.canvas.getContext("2d");
    const { scale, middle } = this.view(width, height);
    const place = ([x, y]) => [width / 2 + (x - middle[0]) * scale, height / 2 - (y - middle[1]) * scale];
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.grid(pen, width, height, scale, middle, place);
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 4;
    pen.lineJoin = pen.lineCap = "round";
    pen.beginPath();
    for (const point of [...this.points, this.pose]) pen.lineTo(...place(point));
    pen.stroke();
    this.car(pen, place(this.pose), this.pose[2]);
  }

  grid(pen, width, height, scale, middle, place) {
    const step = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((metres) => metres * scale > 50) ?? 2000;
    pen.strokeStyle = colour("--line");
    pen.fillStyle = colour("--quiet");
    pen.lineWidth = 1;
    pen.font = "11px system-ui, sans-serif";
    const reach = [width / scale / 2, height / scale / 2];
    for (let x = Math.ceil((middle[0] - reach[0]) / step) * step; x < middle[0] + reach[0]; x += step) {
      const [px] = place([x, 0]);
      pen.beginPath(); pen.moveTo(px, 0); pen.lineTo(px, height); pen.stroke();
    }
    for (let y = Math.ceil((middle[1] - reach[1]) / step) * step; y < middle[1] + reach[1]; y += step) {
      const [, py] = place([0, y]);
      pen.beginPath(); pen.moveTo(0, py); pen.lineTo(width, py); pen.stroke();
    }
    pen.fillText(`grid ${step} m`, 12, 20);
  }

  car(pen, [x, y], heading) {
    pen.save();
    pen.translate(x, y);
    pen.rotate(-heading);
    pen.fillStyle = colour("--text");
    pen.beginPath();
    pen.moveTo(13, 0); pen.lineTo(-9, 8); pen.lineTo(-5, 0); pen.lineTo(-9, -8);
    pen.closePath();
    pen.fill();
    pen.restore();
  }
}
