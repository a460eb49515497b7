// Curves, histogram and mode strip.

// Colours that differ in print and for the colour-blind (Okabe, Ito 2008).
const COLOURS = ["#0072b2", "#d55e00", "#009e73"];
const MODE_COLOURS = { idle: "#b8c0ca", hold: "#56b4e9", track: "#e69f00", balance: "#009e73", stop: "#cc79a7", fault: "#c1272d" };
const FONT = "12px system-ui, Arial, sans-serif";

// Replaces null, by which non-finite numbers are sent, by NaN: null would count as 0.
const numbers = values => values.map(v => v === null ? NaN : v);

// Sizes a canvas to its element on the page; returns its context in CSS pixels, width and height, or null if the element has
// no area: in a tab that was never shown, or a window without width.
function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = canvas;
  const [pw, ph] = [Math.round(w * ratio), Math.round(h * ratio)];
  if (!pw || !ph) return null;
  if (canvas.width !== pw || canvas.height !== ph) { canvas.width = pw; canvas.height = ph; }
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, w, h);
  g.font = FONT;
  return [g, w, h];
}

// Round numbers, about `count` of them, in [from, to].
function ticks(from, to, count) {
  const raw = (to - from) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(f => f * power).find(s => s >= raw * 0.999);
  const result = [];
  for (let i = Math.ceil(from / step); i * step <= to; i++) result.push(+(i * step).toPrecision(6));
  return result;
}

// One line of text for each joint without a motor. `position(i)`: position of joint i, rad or m.
function freeJoints(joints, position) {
  return joints.map((joint, i) => ({ ...joint, q: position(i) })).filter(joint => joint.motor === null).map(joint => {
    const shown = joint.unit === "deg" ? (joint.q * 180 / Math.PI).toFixed(1) : joint.q.toFixed(3);
    return `${joint.name} ${shown.padStart(7)} ${joint.unit}`;
  });
}

// What the motors of the joints give: torques, forces of prismatic joints, or both.
function effort(joints) {
  const units = joints.filter(joint => joint.motor !== null).map(joint => joint.unit);
  return [["deg", "torque"], ["m", "force"]].filter(([unit]) => units.includes(unit)).map(([, name]) => name).join(", ");
}

// Panel with curves of joints over time. `curves`: { label, colour, values, desired, parts }.
class Panel {
  constructor(parent, title, t, curves, seek) {
    Object.assign(this, { title, t, curves });
    this.canvas = parent.appendChild(document.createElement("canvas"));
    this.canvas.setAttribute("aria-label", `${title}: ${curves.map(c => c.label).join(", ")}`);
    this.picture = document.createElement("canvas");
    const move = e => { if (e.buttons) seek(this.time(e.offsetX)); };
    this.canvas.addEventListener("pointerdown", e => { this.canvas.setPointerCapture(e.pointerId); move(e); });
    this.canvas.addEventListener("pointermove", move);
  }

  time(x) { return this.t[0] + (x - 38) / (this.canvas.clientWidth - 46) * (this.t[this.t.length - 1] - this.t[0]); }
  x(t) { return 38 + (t - this.t[0]) / ((this.t[this.t.length - 1] - this.t[0]) || 1) * (this.width - 46); }
  y(v) { return 22 + (1 - v / this.top) / 2 * (this.height - 44); }

  // Draws the curves into an image, once per size: afterwards only the cursor moves.
  render() {
    const largest = (most, column) => column.reduce((m, v) => Math.max(m, Math.abs(v) || 0), most);
    this.top = this.curves.reduce((most, c) => largest(largest(most, c.values), c.desired || []), 1) * 1.08;
    const place = prepare(this.canvas);
    if (!place) return;
    const [, w, h] = place;
    [this.width, this.height] = [w, h];
    const ratio = this.canvas.width / w;
    this.picture.width = this.canvas.width; this.picture.height = this.canvas.height;
    const g = this.picture.getContext("2d");
    g.scale(ratio, ratio);
    g.font = FONT;
    g.textAlign = "right"; g.textBaseline = "middle";
    for (const v of ticks(-this.top, this.top, 5)) {
      g.strokeStyle = "#eceff3"; this.stroke(g, [[38, this.y(v)], [w - 8, this.y(v)]]);
      g.fillStyle = "#6b7685"; g.fillText(v, 33, this.y(v));
    }
    g.textAlign = "center"; g.textBaseline = "top";
    for (const t of ticks(this.t[0], this.t[this.t.length - 1], 8)) g.fillText(t, this.x(t), h - 18);
    g.strokeStyle = "#8a94a3";
    for (const limit of [-1, 1]) this.stroke(g, [[38, this.y(limit)], [w - 8, this.y(limit)]]);
    for (const c of this.curves) {
      g.strokeStyle = c.colour; g.lineWidth = 1.8;
      this.stroke(g, c.values.map((v, i) => [this.x(this.t[i]), this.y(v)]));
    }
    g.strokeStyle = "#000"; g.lineWidth = 1; g.setLineDash([4, 4]);
    // Desired values exist only where a plan is followed.
    for (const c of this.curves) for (const part of c.desired ? c.parts : []) {
      this.stroke(g, part.map(i => [this.x(this.t[i]), this.y(c.desired[i])]));
    }
  }

  // Draws a line through points; NaN leaves a gap.
  stroke(g, points) {
    g.beginPath();
    let drawn = false;
    for (const [x, y] of points) {
      if (drawn) g.lineTo(x, y); else g.moveTo(x, y);
      drawn = Number.isFinite(y);
    }
    g.stroke();
  }

  draw(t, sample) {
    const place = prepare(this.canvas);
    if (!place) return;
    const [g, w, h] = place;
    // The canvas was sized after the curves were drawn.
    if (this.picture.width !== this.canvas.width || this.picture.height !== this.canvas.height) this.render();
    g.drawImage(this.picture, 0, 0, w, h);
    g.strokeStyle = "#c1272d"; g.lineWidth = 1.2;
    this.stroke(g, [[this.x(t), 22], [this.x(t), h - 22]]);
    g.textBaseline = "top"; g.textAlign = "left"; g.fillStyle = "#1c2430";
    g.fillText(this.title, 38, 4);
    g.textAlign = "right";
    [...this.curves].reverse().reduce((x, c) => {
      const text = `${c.label} ${(100 * sample(c.values)).toFixed(0)} %`;
      g.fillStyle = c.colour;
      g.fillText(text, x, 4);
      return x - g.measureText(text).width - 12;
    }, w - 8);
  }
}

// Draws the modes over time, with overrun cycles as ticks.
function drawTimeline(canvas, modes, late, from, to, t) {
  const place = prepare(canvas);
  if (!place) return;
  const [g, w, h] = place;
  const x = s => (s - from) / ((to - from) || 1) * w;
  g.textBaseline = "middle";
  for (const mode of modes) {
    const a = x(mode.from), width = Math.max(x(mode.to) - a, 1);
    g.fillStyle = MODE_COLOURS[mode.name.split(":")[0]] || "#333";
    g.fillRect(a, 4, width, h - 8);
    g.fillStyle = "#10151c";
    if (g.measureText(mode.name).width < width - 8) g.fillText(mode.name, a + 6, h / 2);
  }
  g.fillStyle = "#c1272d";
  for (const s of late) g.fillRect(x(s), h - 4, 1, 4);
  g.fillRect(x(t) - 1, 0, 2, h);
}

// Draws histograms with logarithmic axes of duration and count, so that the few slow cycles are visible.
function drawTimes(canvas, all, period) {
  const place = prepare(canvas);
  if (!place) return;
  const [g, w, h] = place;
  const [left, right, top, bottom] = [44, w - 8, 20, h - 34];
  if (!all.length) {
    g.fillStyle = "#6b7685"; g.fillText("Not measured: the clock was lockstep.", left, h / 2);
    return;
  }
  const ends = all.flatMap(a => [a.first, a.first * a.ratio ** a.counts.length]).concat(period * 1.3);
  const [lo, hi] = [Math.log10(Math.min(...ends)), Math.log10(Math.max(...ends))];
  const most = Math.log10(Math.max(...all.flatMap(a => a.counts)));
  // Label of 10^e with a unit prefix, 100, 1k, 10k, 100k, 1M: each fits into its space.
  const short = e => e < 3 ? `${+(10 ** e).toPrecision(3)}` : `${10 ** (e % 3)}${["", "k", "M", "G", "T"][Math.floor(e / 3)] || `e${e}`}`;
  const x = us => left + (Math.log10(us) - lo) / (hi - lo) * (right - left);
  const y = count => count ? bottom - (Math.log10(count) + 0.3) / (most + 0.4) * (bottom - top) : bottom;
  g.fillStyle = "#6b7685"; g.textAlign = "center"; g.textBaseline = "top";
  for (let e = Math.ceil(lo); e <= hi; e++) { g.fillText(short(e), x(10 ** e), bottom + 4); g.fillRect(x(10 ** e), bottom, 1, 4); }
  g.fillText("us", (left + right) / 2, bottom + 18);
  g.textAlign = "right"; g.textBaseline = "middle";
  for (let e = 0; e <= most; e++) { g.fillText(short(e), left - 6, y(10 ** e)); g.fillRect(left - 3, y(10 ** e), 3, 1); }
  all.forEach((a, k) => {
    g.fillStyle = COLOURS[k] + "99";
    a.counts.forEach((count, i) => {
      const from = x(a.first * a.ratio ** i), to = x(a.first * a.ratio ** (i + 1));
      g.fillRect(from, y(count), to - from - 0.5, bottom - y(count));
    });
    g.textAlign = "left"; g.textBaseline = "top"; g.fillStyle = COLOURS[k];
    g.fillText(a.name, left + 90 * k, 2);
  });
  g.strokeStyle = "#c1272d"; g.setLineDash([4, 3]);
  g.beginPath(); g.moveTo(x(period), top); g.lineTo(x(period), bottom); g.stroke(); g.setLineDash([]);
  g.fillStyle = "#c1272d"; g.textAlign = "right"; g.fillText(`period ${Math.round(period)} us`, right, 2);
  g.fillStyle = "#8a94a3"; g.fillRect(left, bottom, right - left, 1);
}
