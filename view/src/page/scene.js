"use strict";
// Scene with the robot: forward kinematics of the links, drawn as shaded capsules, farthest first.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const mix = (a, b, s) => a.map((v, i) => v + (b[i] - v) * s);
const apply = (m, v) => m.map(r => r[0] * v[0] + r[1] * v[1] + r[2] * v[2]);
const times = (a, b) => a.map(r => [0, 1, 2].map(j => r[0] * b[0][j] + r[1] * b[1][j] + r[2] * b[2][j]));

// Rotation matrix about a unit axis (Rodrigues' formula).
function turn([x, y, z], angle) {
  const c = Math.cos(angle), s = Math.sin(angle), d = 1 - c;
  return [
    [c + x * x * d, x * y * d - z * s, x * z * d + y * s],
    [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
    [z * x * d - y * s, z * y * d + x * s, c + z * z * d],
  ];
}

// Position and rotation of each link in the world frame at the joint positions q, rad or m.
function poses(links, q) {
  const result = [];
  for (const link of links) {
    const parent = link.parent === null ? { p: [0, 0, 0], r: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] } : result[link.parent];
    let r = times(parent.r, link.rotation);
    let p = add(parent.p, apply(parent.r, link.origin));
    if (link.joint !== null) {
      if (link.slides) p = add(p, apply(r, link.axis.map(v => v * q[link.joint])));
      else r = times(r, turn(link.axis, q[link.joint]));
    }
    result.push({ p, r });
  }
  return result;
}

class Scene {
  constructor(canvas, links, joints, changed) {
    this.canvas = canvas;
    this.links = links;
    this.camera = { azimuth: -0.95, elevation: 0.14, zoom: 1.6, target: [0, 0, 0] };
    [this.low, this.high, this.size] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity], 0.2];
    // Slides that an unactuated joint carries, such as a hoist, hang on a rope.
    const carried = [];
    links.forEach((link, i) => {
      const above = link.parent, joint = above === null ? null : links[above].joint;
      carried[i] = above !== null && (carried[above] || (joint !== null && joints[joint].motor === null));
    });
    this.hanging = links.map((link, i) => i).filter(i => links[i].slides && carried[i]);
    const rod = links[links.length - 1];
    const ends = rod.shapes.flatMap(s => [s.a, s.b]);
    const length = v => Math.hypot(...v);
    this.tipInRod = ends.reduce((far, v) => (length(v) > length(far) ? v : far), [0, 0, 0]);
    canvas.addEventListener("pointerdown", e => canvas.setPointerCapture(e.pointerId));
    canvas.addEventListener("pointermove", e => {
      if (!e.buttons) return;
      this.camera.azimuth -= e.movementX * 0.008;
      this.camera.elevation = Math.max(-1.4, Math.min(1.4, this.camera.elevation + e.movementY * 0.008));
      changed();
    });
    canvas.addEventListener("wheel", e => {
      e.preventDefault();
      this.camera.zoom = Math.max(0.5, Math.min(6, this.camera.zoom * Math.exp(e.deltaY * 0.001)));
      changed();
    }, { passive: false });
  }

  // Extends the picture so that the robot at the positions q is in it.
  fit(q) {
    if (!q.every(Number.isFinite)) return;
    const now = poses(this.links, q);
    const points = this.links.flatMap((link, i) => link.shapes.flatMap(s => [s.a, s.b]).map(v => add(now[i].p, apply(now[i].r, v))));
    if (!points.length) return;
    [this.low, this.high] = [[Math.min, this.low], [Math.max, this.high]].map(([f, end]) => end.map((v, k) => points.reduce((m, p) => f(m, p[k]), v)));
    this.size = Math.max(Math.hypot(...this.high.map((v, k) => v - this.low[k])), 0.2);
    this.camera.target = mix(this.low, this.high, 0.5);
  }

  // Projects a point in the world frame, m, to [px, px, px per m, depth in m].
  project(v) {
    const { azimuth: a, elevation: e, zoom, target } = this.camera, distance = zoom * this.size;
    const [x, y, z] = v.map((c, i) => c - target[i]);
    const ahead = -x * Math.cos(a) - y * Math.sin(a), right = -x * Math.sin(a) + y * Math.cos(a);
    const depth = distance + ahead * Math.cos(e) - z * Math.sin(e);
    const up = z * Math.cos(e) + ahead * Math.sin(e);
    const scale = 1.35 * Math.min(this.height, 1.2 * this.width) / Math.max(depth, 0.05);
    return [this.width / 2 + right * scale, this.height / 2 - up * scale, scale, depth];
  }

  tip(q) {
    const pose = poses(this.links, q).pop();
    return add(pose.p, apply(pose.r, this.tipInRod));
  }

  line(a, b, style, width, dash = []) {
    const [p, r] = [this.project(a), this.project(b)];
    const g = this.g;
    g.strokeStyle = style; g.lineWidth = width; g.setLineDash(dash); g.lineCap = "round";
    g.beginPath(); g.moveTo(p[0], p[1]); g.lineTo(r[0], r[1]); g.stroke();
    g.setLineDash([]);
  }

  grid(z, half, style) {
    for (let i = -4; i <= 4; i++) {
      const c = half * i / 4;
      this.line([c, -half, z], [c, half, z], style, 1);
      this.line([-half, c, z], [half, c, z], style, 1);
    }
  }

  // `desired`: angles, rad, or null; `trail`: past positions of the tip, m, oldest first.
  draw(q, desired, trail) {
    const place = prepare(this.canvas);
    if (!place) return;
    [this.g, this.width, this.height] = place;
    const g = this.g;
    const sky = g.createLinearGradient(0, 0, 0, this.height);
    sky.addColorStop(0, "#eef2f7"); sky.addColorStop(1, "#fbfcfd");
    g.fillStyle = sky; g.fillRect(0, 0, this.width, this.height);
    const now = poses(this.links, q);
    this.grid(0, 0.6 * this.size, "#dfe4ea");
    this.grid(now[Math.min(1, now.length - 1)].p[2], 0.24 * this.size, "#c3ccd6");
    trail.slice(1).forEach((v, i) => this.line(trail[i], v, `rgba(140, 20, 25, ${0.55 * (i + 1) / trail.length})`, 2));
    for (const i of this.hanging) {
      const link = this.links[i], parent = now[link.parent];
      this.line(add(parent.p, apply(parent.r, link.origin)), now[i].p, "#333", 2);
    }
    const pieces = this.links.flatMap((link, i) => link.shapes.map(shape => {
      const [a, b] = [shape.a, shape.b].map(v => add(now[i].p, apply(now[i].r, v)));
      return { a, b, shape, depth: this.project(mix(a, b, 0.5))[3] };
    }));
    pieces.sort((x, y) => y.depth - x.depth);
    for (const { a, b, shape } of pieces) {
      const width = Math.max(2 * shape.radius * this.project(mix(a, b, 0.5))[2], 2.5);
      const shade = f => `rgb(${shape.colour.map(c => Math.round(Math.min(255, c * f + (f > 1 ? 30 : 0)))).join(",")})`;
      this.line(a, b, shade(0.55), width + 1.5);
      this.line(a, b, shade(0.92), width);
      // Highlight of a round body lit from above.
      const light = [0, 0, shape.radius * 0.45];
      if (width > 6) this.line(add(a, light), add(b, light), shade(1.08), width * 0.35);
    }
    if (desired) {
      const rod = poses(this.links, desired).pop();
      this.line(rod.p, add(rod.p, apply(rod.r, this.tipInRod)), "#000", 1.5, [5, 5]);
    }
  }
}
