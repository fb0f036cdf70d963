"use strict";
// A mechanism that plays and turns, on a plain canvas: no library, no request. The data stand in the page as JSON.
// A parallel projection, as in the drawings: lengths along the paper are true. What is nearer is drawn later.

const INK = "#262626";

function floats(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new Float32Array(bytes.buffer);
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

function turned(q, v) {  // R(q) v of a unit quaternion, scalar first
  if (!q) return v;
  const [w, x, y, z] = q;
  const t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])];
  return [v[0] + w * t[0] + y * t[2] - z * t[1], v[1] + w * t[1] + z * t[0] - x * t[2], v[2] + w * t[2] + x * t[1] - y * t[0]];
}

function hull(points) {  // Andrew's monotone chain
  const order = points.slice().sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  const chain = list => {
    const kept = [];
    for (const p of list) {
      while (kept.length > 1 && turn(kept[kept.length - 2], kept[kept.length - 1], p) <= 0) kept.pop();
      kept.push(p);
    }
    kept.pop();
    return kept;
  };
  return order.length < 3 ? order : chain(order).concat(chain(order.slice().reverse()));
}

function area(p) {
  let sum = 0;
  for (let i = 0; i < p.length; i++) {
    const a = p[i], b = p[(i + 1) % p.length];
    sum += a[0] * b[1] - b[0] * a[1];
  }
  return sum;
}

function element(kind, attributes, parent, text) {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  if (parent) parent.appendChild(made);
  return made;
}

class Viewer {
  constructor(place) {
    this.all = JSON.parse(place.querySelector("script").textContent);
    for (const one of this.all) {
      one.pose = floats(one.poses);
      for (const track of one.tracks) track.at = floats(track.points);
      for (const joint of one.joints) joint.at = floats(joint.path);
    }
    this.place = place;
    this.canvas = element("canvas", { role: "img", "aria-label": "The mechanism in space; drag to turn it" }, place);
    this.pen = this.canvas.getContext("2d");
    this.bar = element("div", { class: "bar" }, place);
    if (this.all.length > 1) this.addChoice();
    this.addTime();
    this.addSwitches();
    const circles = " Circles on the right: the ball's center in its socket, magnified; the angle is that of the view, the distance true.";
    element("p", { class: "says" }, place, "Drag: turn. Shift and drag: move. Wheel: zoom. Double click: as at the start."
      + (this.all.some(one => one.joints.length) ? circles : ""));
    this.choose(0);
    this.listen();
  }

  addChoice() {
    const list = element("select", { "aria-label": "which motion" }, this.bar);
    this.all.forEach((one, i) => element("option", { value: i }, list, one.name));
    list.addEventListener("change", () => this.choose(Number(list.value)));
  }

  addTime() {
    this.button = element("button", { type: "button" }, this.bar, "Play");
    this.button.addEventListener("click", () => this.play(!this.playing));
    this.slider = element("input", { type: "range", min: 0, max: 1, step: "any", value: 0, "aria-label": "time" }, this.bar);
    this.slider.addEventListener("input", () => { this.play(false); this.show(Number(this.slider.value)); });
    this.output = element("output", {}, this.bar);
    const label = element("label", {}, this.bar, "speed ");
    this.speed = element("select", {}, label);
    for (let power = -6; power < 4; power++)
      for (const digit of [1, 2, 5]) {
        const x = Number((digit * 10 ** power).toPrecision(1));
        element("option", { value: x }, this.speed, x < 1 ? `${Number((1 / x).toPrecision(2))} times slower` : x > 1 ? `${x} times faster` : "true");
      }
  }

  addSwitches() {
    const box = (text, on) => {
      const label = element("label", {}, this.bar), input = element("input", { type: "checkbox" }, label);
      label.append(` ${text}`);
      input.checked = on;
      input.addEventListener("change", () => this.draw());
      return input;
    };
    this.names = box("names", true);
    this.paths = box("paths", true);
  }

  choose(i) {
    this.one = this.all[i];
    const moves = this.one.frames > 1, span = this.one.end - this.one.start;
    for (const part of [this.button, this.slider, this.speed.parentNode]) part.hidden = !moves;
    if (moves) {  // a film of some six seconds
      const values = [...this.speed.options].map(option => Number(option.value));
      const far = x => Math.abs(Math.log(x * 6 / span));
      this.speed.value = values.reduce((a, b) => far(b) < far(a) ? b : a);
    }
    this.share = 0;
    this.slider.value = 0;
    this.asAtStart();
    this.play(false);
    this.resize();
  }

  asAtStart() {
    [this.azimuth, this.elevation] = this.one.view;
    this.zoom = null;  // as large as fits, until somebody zooms
    this.shift = [0, 0];
  }

  fitting() {  // the view at the start is known, and filled; turned, the ball around everything is
    const wide = (this.size[0] - this.room) / 2 - 46, high = this.size[1] / 2 - 46, [a, b] = this.one.half;
    const isAtStart = this.azimuth === this.one.view[0] && this.elevation === this.one.view[1];
    return isAtStart ? Math.min(wide / a, high / b) : Math.min(wide, high) / this.one.radius;
  }

  listen() {
    let from = null;
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", event => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointercancel", () => { from = null; });
    canvas.addEventListener("pointermove", event => {
      if (!from) return;
      const across = event.clientX - from[0], down = event.clientY - from[1];
      from = [event.clientX, event.clientY];
      if (event.shiftKey) this.shift = [this.shift[0] + across, this.shift[1] + down];
      else {
        this.zoom = this.scale;  // no jump of the size at the first turn
        this.azimuth -= 0.4 * across;
        this.elevation = Math.max(-90, Math.min(90, this.elevation + 0.4 * down));
      }
      this.draw();
    });
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      const fit = this.fitting();
      this.zoom = Math.max(0.1 * fit, Math.min(200 * fit, this.scale * Math.exp(-0.0015 * event.deltaY)));
      this.draw();
    }, { passive: false });
    canvas.addEventListener("dblclick", () => { this.asAtStart(); this.draw(); });
    window.addEventListener("resize", () => this.resize());
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (this.share >= 1) this.share = 0;
    let last = null;
    const step = now => {
      if (!this.playing) return;
      if (last !== null) {
        const moved = Number(this.speed.value) * (now - last) / 1000 / (this.one.end - this.one.start);
        this.show(Math.min(1, this.share + moved));
        this.slider.value = this.share;
      }
      last = now;
      if (this.share >= 1) this.play(false); else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  show(share) { this.share = share; this.draw(); }

  resize() {
    const width = this.canvas.clientWidth || 800, height = Math.round(Math.max(300, Math.min(560, 0.58 * width)));
    const ratio = window.devicePixelRatio || 1;
    this.canvas.style.height = `${height}px`;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.size = [width, height];
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.draw();
  }

  // What is where ---------------------------------------------------------------------------------------------------

  between(values, width, n) {  // a row of frames, straight between two
    const x = this.share * (n - 1), i = Math.min(Math.floor(x), n - 1), j = Math.min(i + 1, n - 1), f = x - i, row = [];
    for (let k = 0; k < width; k++) row.push((1 - f) * values[i * width + k] + f * values[j * width + k]);
    return row;
  }

  pose() {
    const n = this.one.bodies.length, row = this.between(this.one.pose, 7 * n, this.one.frames);
    this.at = [];
    this.turn = [];
    for (let b = 0; b < n; b++) {
      const q = row.slice(7 * b + 3, 7 * b + 7), norm = Math.hypot(...q) || 1;
      this.at.push(row.slice(7 * b, 7 * b + 3));
      this.turn.push(q.map(x => x / norm));
    }
    this.at[-1] = [0, 0, 0];
    this.turn[-1] = null;
  }

  camera() {
    const [first, second, up] = this.one.axes, a = this.azimuth * Math.PI / 180, e = this.elevation * Math.PI / 180;
    const mix = (x, y, z) => [0, 1, 2].map(i => x * first[i] + y * second[i] + z * up[i]);
    this.right = mix(-Math.sin(a), Math.cos(a), 0);
    this.up = mix(-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e));
    this.toward = mix(Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e));
    this.room = this.one.joints.length && this.size[0] > 480 ? 150 : 0;
    this.scale = this.zoom ?? this.fitting();
  }

  project(p) {
    const d = [p[0] - this.one.middle[0], p[1] - this.one.middle[1], p[2] - this.one.middle[2]];
    return [
      (this.size[0] - this.room) / 2 + this.shift[0] + this.scale * dot(d, this.right),
      this.size[1] / 2 + this.shift[1] - this.scale * dot(d, this.up),
      dot(d, this.toward),
    ];
  }

  anchor(body, place) { return add(this.at[body], turned(this.turn[body], place)); }

  // Drawing ---------------------------------------------------------------------------------------------------------

  draw() {
    const one = this.one, pen = this.pen;
    pen.clearRect(0, 0, ...this.size);
    this.pose();
    this.camera();
    const t = one.start + this.share * (one.end - one.start), digits = Math.max(0, Math.min(9, Math.ceil(3 - Math.log10(one.end - one.start || 1))));
    this.output.textContent = one.frames > 1 ? `t = ${t.toFixed(digits)} s of ${one.end.toFixed(digits)} s` : "at the start";
    if (this.paths.checked) this.drawPaths();
    for (const track of one.tracks) this.drawTrack(track);
    const drawn = one.shapes.filter(shape => shape.kind !== "name").map(shape => {
      const at = this.anchor(shape.body, shape.at);
      const corners = shape.corners.map(corner => this.project(add(at, turned(this.turn[shape.frame], corner))));
      const point = this.project(at), all = corners.length ? corners : [point];
      return { shape, point, corners, depth: all.reduce((sum, p) => sum + p[2], 0) / all.length };
    });
    // As on paper: bands one after the other, in them groups by depth, and a group in its own order.
    const depths = new Map();
    for (const { shape, depth } of drawn) depths.set(shape.group, Math.max(depths.get(shape.group) ?? -Infinity, depth));
    drawn.sort((a, b) => a.shape.band - b.shape.band || depths.get(a.shape.group) - depths.get(b.shape.group) || a.shape.group - b.shape.group);
    for (const each of drawn) this.drawShape(each);
    if (this.names.checked) this.drawNames();
    this.drawAxes();
    if (this.room) this.drawJoints();
  }

  line(points, color, width, dashed) {
    const pen = this.pen;
    pen.beginPath();
    points.forEach((p, i) => i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]));
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.lineCap = pen.lineJoin = "round";
    pen.setLineDash(dashed ? [8, 3, 2, 3] : []);
    pen.stroke();
    pen.setLineDash([]);
  }

  fill(points, color, alpha, edge, width) {
    const pen = this.pen;
    pen.beginPath();
    points.forEach((p, i) => i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]));
    pen.closePath();
    if (color && color !== "none") {
      pen.globalAlpha = alpha ?? 1;
      pen.fillStyle = color;
      pen.fill();
      pen.globalAlpha = 1;
    }
    if (edge) {
      pen.strokeStyle = edge;
      pen.lineWidth = width || 0.9;
      pen.lineJoin = "round";
      pen.stroke();
    }
  }

  arrow(points, color, width) {
    this.line(points, color, width);
    const tip = points[points.length - 1], before = points[points.length - 2];
    const length = Math.hypot(tip[0] - before[0], tip[1] - before[1]);
    if (length < 0.5) return;
    const u = [(tip[0] - before[0]) / length, (tip[1] - before[1]) / length], h = 9;
    const base = [tip[0] - h * u[0], tip[1] - h * u[1]];
    this.fill([tip, [base[0] - 4 * u[1], base[1] + 4 * u[0]], [base[0] + 4 * u[1], base[1] - 4 * u[0]]], color, 1);
  }

  drawShape({ shape, point, corners }) {
    const r = Math.abs(shape.radius || 0) * this.scale, [x, y] = point, edge = shape.edge, pen = this.pen;
    const round = radius => Array.from({ length: 33 }, (_, i) => [x + radius * Math.cos(i * Math.PI / 16), y + radius * Math.sin(i * Math.PI / 16)]);
    switch (shape.kind) {
      case "line":
        if (shape.rim) this.line(corners, "#ffffff", shape.width + shape.rim);
        if (shape.arrow) this.arrow(corners, edge, shape.width); else this.line(corners, edge, shape.width, shape.dashed);
        break;
      case "hull": this.fill(hull(corners), shape.face, shape.alpha, edge, shape.width); break;
      case "side":  // outlines run counterclockwise from outside; y points down on the screen
        if (area(corners) < 0) { this.fill(corners, "#ffffff", 1); this.fill(corners, shape.face, shape.alpha, edge, shape.width); }
        break;
      case "face": this.fill(corners, shape.face, shape.alpha, edge, shape.width); break;
      case "ball": this.fill(round(r), shape.face, 1, edge, shape.width); break;
      case "square": this.fill([[x - r, y - r], [x + r, y - r], [x + r, y + r], [x - r, y + r]], shape.face, 1, edge); break;
      case "diamond": this.fill([[x - r, y], [x, y - r], [x + r, y], [x, y + r]], shape.face, 1, edge, 1.1); break;
      case "center":
        this.fill(round(r), "#ffffff", 1, INK, 0.6);
        for (const k of [0, Math.PI]) {
          pen.beginPath(); pen.moveTo(x, y); pen.arc(x, y, r, k, k + Math.PI / 2); pen.closePath(); pen.fillStyle = INK; pen.fill();
        }
        break;
      case "ground": this.drawGround(x, y, r * Math.sign(shape.radius), edge); break;
      case "link": this.drawLink(shape, point); break;
      case "spiral":
        this.line(Array.from({ length: 81 }, (_, i) => { const a = i * Math.PI / 16, q = r * (0.5 + 0.5 * i / 80); return [x + q * Math.cos(a), y + q * Math.sin(a)]; }), edge, 1);
    }
  }

  drawGround(x, y, s, color) {
    const at = (a, b) => [x + s * a, y - s * b];
    this.fill([at(0, 0), at(-1.3, -2.1), at(1.3, -2.1)], "#e0e0e0", 1, color, 0.8);
    this.line([at(-2.1, -2.1), at(2.1, -2.1)], color, 1.4);
    for (let i = 0; i < 6; i++) this.line([at(-1.5 + 0.72 * i, -2.1), at(-2.2 + 0.72 * i, -2.9)], color, 0.7);
  }

  drawLink(shape, a) {
    const b = this.project(this.anchor(shape.body2, shape.at2)), d = [b[0] - a[0], b[1] - a[1]];
    const s = (shape.zigzag || shape.barrel || 0) * this.scale / (Math.hypot(...d) || 1);
    const at = (f, side) => [a[0] + f * d[0] - side * s * d[1], a[1] + f * d[1] + side * s * d[0]];
    if (shape.barrel) {  // open, so that bodies behind it stay visible, and a rod
      const ends = [[0, 0, 0.2, 0], [0.2, 1, 0.6, 1], [0.6, 1, 0.6, -1], [0.6, -1, 0.2, -1], [0.2, -1, 0.2, 1], [0.42, 1, 0.42, -1], [0.42, 0, 1, 0]];
      for (const [f, p, g, q] of ends) this.line([at(f, p), at(g, q)], shape.edge, shape.width);
      return;
    }
    let points = [a, b];
    if (shape.zigzag) {
      const shares = [0, 0.18], sides = [0, 0];
      for (let i = 0; i < 12; i++) { shares.push(0.22 + 0.56 * i / 11); sides.push(i % 2 ? -1 : 1); }
      shares.push(0.82, 1); sides.push(0, 0);
      points = shares.map((f, i) => at(f, sides[i]));
    }
    this.line(points, "#ffffff", shape.width + 2);
    this.line(points, shape.edge, shape.width);
  }

  drawPaths() {  // of the centers of mass, up to now
    const one = this.one, n = one.bodies.length, last = Math.floor(this.share * (one.frames - 1));
    for (let b = 0; b < n; b++) {
      const points = [];
      for (let i = 0; i <= last; i++) points.push(this.project(one.pose.subarray(7 * (i * n + b), 7 * (i * n + b) + 3)));
      points.push(this.project(this.at[b]));
      this.pen.globalAlpha = 0.45;
      this.line(points, one.colors[b], 1);
      this.pen.globalAlpha = 1;
    }
  }

  drawTrack(track) {
    const [n, k] = track.shape, row = this.between(track.at, 3 * k, n), points = [];
    for (let i = 0; i < k; i++) points.push(this.project(row.slice(3 * i, 3 * i + 3)));
    if (track.arrow) this.arrow(points, track.edge, track.width); else this.line(points, track.edge, track.width);
  }

  drawNames() {
    const pen = this.pen, taken = [];
    pen.textBaseline = "middle";
    for (const shape of this.one.shapes.filter(one => one.kind === "name")) {
      const [x, y] = this.project(this.anchor(shape.body, shape.at));
      pen.font = shape.quiet ? "11px system-ui, sans-serif" : "600 12px system-ui, sans-serif";
      const width = pen.measureText(shape.text).width;
      const free = [[10, -12], [10, 12], [-10 - width, -12], [-10 - width, 12], [-width / 2, -22], [-width / 2, 22], [10, -28], [10, 28]]
        .map(([a, b]) => [x + a, y + b - 7, x + a + width, y + b + 7])
        .find(box => taken.every(other => box[2] < other[0] || box[0] > other[2] || box[3] < other[1] || box[1] > other[3]));
      if (!free) continue;  // better no name than two on top of each other
      taken.push(free);
      pen.lineWidth = 3;
      pen.strokeStyle = "#ffffff";
      pen.strokeText(shape.text, free[0], free[1] + 7);
      pen.fillStyle = shape.edge;
      pen.fillText(shape.text, free[0], free[1] + 7);
    }
  }

  drawAxes() {
    const pen = this.pen, x = 38, y = this.size[1] - 38, [unit, factor] = this.one.unit;
    ["#CC3311", "#117733", "#0044AA"].forEach((color, i) => {
      const tip = [x + 26 * this.right[i], y - 26 * this.up[i]];
      this.line([[x, y], tip], color, 1.6);
      pen.fillStyle = color;
      pen.font = "11px system-ui, sans-serif";
      pen.textBaseline = "middle";
      pen.fillText("xyz"[i], x + 34 * this.right[i] - 3, y - 34 * this.up[i]);
    });
    const most = 120 / this.scale, power = 10 ** Math.floor(Math.log10(most)), length = [5, 2, 1].find(k => k * power <= most * 1.000001) * power;
    const left = 92, right = left + length * this.scale, below = this.size[1] - 16;
    this.line([[left, below], [right, below]], INK, 2);
    pen.fillStyle = INK;
    pen.fillText(`${Number((factor * length).toPrecision(3))} ${unit}`, left, below - 11);
  }

  drawJoints() {  // the angle from the view, the distance the true one
    const pen = this.pen, count = this.one.joints.length, x = this.size[0] - this.room / 2;
    this.one.joints.forEach((joint, i) => {
      const y = this.size[1] * (i + 0.5) / count, r = Math.min(44, this.size[1] / count / 2 - 26);
      const last = Math.floor(this.share * (this.one.frames - 1)), points = [];
      const place = e => {
        const a = dot(e, this.right), b = dot(e, this.up), flat = Math.hypot(a, b), f = flat ? r * Math.hypot(...e) / flat : 0;
        return [x + f * a, y - f * b];
      };
      for (let k = Math.max(0, last - 150); k <= last; k++) points.push(place(joint.at.subarray(3 * k, 3 * k + 3)));
      const now = place(this.between(joint.at, 3, this.one.frames));
      pen.beginPath(); pen.arc(x, y, r, 0, 2 * Math.PI);
      pen.strokeStyle = INK; pen.lineWidth = 1.2; pen.setLineDash(joint.clearance ? [] : [4, 3]); pen.stroke(); pen.setLineDash([]);
      this.line([...points, now], "#56B4E9", 1);
      const touches = joint.clearance && Math.hypot(...this.between(joint.at, 3, this.one.frames)) >= 1;
      pen.beginPath(); pen.arc(now[0], now[1], 4, 0, 2 * Math.PI); pen.fillStyle = touches ? "#D55E00" : "#0072B2"; pen.fill();
      pen.font = "11px system-ui, sans-serif"; pen.fillStyle = INK; pen.textBaseline = "middle"; pen.textAlign = "center";
      pen.fillText(joint.name, x, y - r - 12, this.room - 8);
      const small = joint.radius < 1e-3, radius = Number((joint.radius * (small ? 1e6 : 1e3)).toPrecision(3));
      pen.fillText(`${joint.clearance ? "clearance" : "circle"} ${radius} ${small ? "\u00b5m" : "mm"}`, x, y + r + 12, this.room - 8);
      pen.textAlign = "left";
    });
  }
}

for (const place of document.querySelectorAll(".motion")) place.viewer = new Viewer(place);
