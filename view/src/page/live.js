// Page of a running system: frames come as server-sent events and are drawn at most 20 times a second.

addEventListener("DOMContentLoaded", () => {
  const SPAN = 10;
  // Time between two drawings, ms: motion looks smooth at 20 Hz, and a busy machine is loaded little.
  const PAUSE = 50;
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = id => document.getElementById(id);
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  // Samples of the last SPAN seconds. The panels hold references to these arrays.
  const t = [], modes = [], late = [];
  const columns = n => Array.from({ length: n }, () => []);
  const n = data.joints.length;
  const motion = { q: columns(n), q_d: columns(n), qd: columns(n), qd_d: columns(n), tau: columns(data.limits.tau.length) };
  const limits = { q: data.limits.q, q_d: data.limits.q, qd: data.limits.qd, qd_d: data.limits.qd, tau: data.limits.tau };
  const parts = [];
  let view = null, times = [], connected = false, dirty = false, drawn = -PAUSE;

  const all = Object.values(motion).flat();
  const panels = [];
  for (let first = 0; first < data.joints.length; first += COLOURS.length) {
    const joints = data.joints.slice(first, first + COLOURS.length).map((joint, k) => ({ ...joint, index: first + k, colour: COLOURS[k] }));
    const panel = (title, place, values, wanted) => {
      const curves = joints.filter(joint => place(joint) !== null).map(joint => ({
        label: joint.name, colour: joint.colour, values: values[place(joint)], desired: wanted && wanted[place(joint)], parts,
      }));
      panels.push(new Panel($("panels"), title, t, curves, () => {}));
    };
    panel("position", joint => joint.index, motion.q, motion.q_d);
    panel("velocity", joint => joint.index, motion.qd, motion.qd_d);
    panel(effort(joints), joint => joint.motor, motion.tau, null);
  }
  const scene = new Scene($("scene"), data.links, data.joints, () => { dirty = true; });
  document.title = `${data.domain} - upswing`;
  $("name").textContent = `upswing, domain ${data.domain}`;

  function take(frame) {
    ({ view, times } = frame);
    const m = frame.motion;
    // An earlier time comes from another plant, whose clock starts at 0: the old samples are dropped.
    if (m.t.length && t.length && m.t[0] < t[t.length - 1]) [t, modes, late, ...all].forEach(a => { a.length = 0; });
    t.push(...m.t); modes.push(...m.mode); late.push(...m.late);
    for (const [name, columns] of Object.entries(motion)) {
      columns.forEach((column, i) => column.push(...numbers(m[name][i]).map(v => v / limits[name][i])));
    }
    const old = t.findIndex(s => s >= t[t.length - 1] - SPAN);
    if (old > 0) [t, modes, ...all].forEach(a => a.splice(0, old));
    while (late.length && late[0] < t[0]) late.shift();
    dirty = true;
  }

  const runs = () => {
    const spans = [];
    modes.forEach((name, i) => {
      const last = spans[spans.length - 1];
      if (last && last.name === name) { last.to = t[i]; last.end = i; }
      else { if (last) last.to = t[i]; spans.push({ name, from: t[i], to: t[i], begin: i, end: i }); }
    });
    return spans;
  };

  function table(id, rows) {
    $(id).replaceChildren(...rows.map(([name, ...values]) => {
      const row = document.createElement("tr");
      row.appendChild(document.createElement("th")).textContent = name;
      values.forEach(v => { row.appendChild(document.createElement("td")).textContent = v; });
      return row;
    }));
  }

  function facts() {
    const here = name => `${name} ${view[name] ? "runs" : "absent"}`;
    $("about").textContent = connected ? ["daemon", "planner", "plant"].map(here).join(", ") : "the monitor does not answer";
    const { cycle, status, plan } = view;
    const fixed = (v, digits) => v === null ? "unknown" : v.toFixed(digits);
    const tilt = cycle && cycle.tilt !== null ? `${(cycle.tilt * 180 / Math.PI).toFixed(1)} deg from upright` : "unknown";
    const rows = [["mode", view.mode || "no daemon"], ["next", view.next || "start a daemon"]];
    if (cycle) {
      rows.push(["fault", cycle.fault || "none"], ["last link", tilt]);
      rows.push(["distance from reference", `${fixed(cycle.error_arm, 4)} (actuated joints), ${fixed(cycle.error_pendulum, 4)} (unactuated joints), rad or m`]);
    }
    if (plan) {
      const at = cycle && cycle.plan === plan.id ? `, at ${fixed(cycle.t_plan, 2)} s` : "";
      rows.push(["plan", `${fixed(plan.t_f, 3)} s, ends ${plan.stands ? "standing" : "hanging"}${at}`]);
    }
    if (status) {
      rows.push(["cycles", `${status.cycles}, ${status.overruns} late, ${view.lost} lost on the way here`]);
      if (status.last_overrun) rows.push(["last late", status.last_overrun]);
      rows.push(["warnings", status.warnings.join(", ") || "none"]);
      if (status.degraded.length) rows.push(["real time, degraded", status.degraded.join(", ")]);
      if (status.remark) rows.push(["remark", status.remark]);
    }
    if (view.asking) rows.push(["asked", `${view.asking} ...`]);
    table("summary", rows);
    table("percentiles", times.length ? [["us", "p50", "p99", "p99.9", "max"], ...times.map(d => [d.name, ...d.percentiles.map(v => v.toFixed(1))])] : []);
    table("events", view.events.map(e => [`${e.t.toFixed(1)} s`, e.text]).reverse());
    [...$("events").rows].reverse().forEach((row, i) => { row.className = view.events[i].kind; });
  }

  function draw(now) {
    requestAnimationFrame(draw);
    if (!dirty || !view || now - drawn < PAUSE) return;
    [dirty, drawn] = [false, now];
    facts();
    drawTimes($("times"), times, data.period_us);
    if (!t.length) return;
    const spans = runs(), end = t[t.length - 1], last = spans[spans.length - 1];
    const follows = name => name === "track" || name === "balance";
    parts.splice(0, parts.length, ...spans.filter(s => follows(s.name)).map(s => {
      return Array.from({ length: s.end - s.begin + 1 }, (_, i) => s.begin + i);
    }));
    const newest = name => motion[name].map((column, i) => column[column.length - 1] * limits[name][i]);
    const trail = [];
    for (let k = t.findIndex(s => s >= end - 1); k < t.length; k += 3) {
      trail.push(scene.tip(motion.q.map((column, i) => column[k] * limits.q[i])));
    }
    const q = newest("q");
    scene.fit(q);
    scene.draw(q, follows(last.name) ? newest("q_d") : null, trail);
    $("readout").textContent = [`mode ${last.name}`, ...freeJoints(data.joints, i => q[i])].join("\n");
    panels.forEach(panel => { panel.render(); panel.draw(end, column => column[column.length - 1]); });
    drawTimeline($("timeline"), spans, late, t[0], end, end);
  }

  async function ask(name) {
    // A stop asks for no confirmation.
    if (name !== "stop" && !confirm(`${name}? The robot may move.`)) return;
    const answer = await fetch(`/request/${name}`, { method: "POST", headers: { Authorization: `Bearer ${token}` } });
    if (!answer.ok) alert(`${name}: ${(await answer.json()).error}`);
  }

  if (data.control && token) {
    for (const name of data.requests) {
      const button = $("requests").appendChild(document.createElement("button"));
      button.type = "button"; button.textContent = name; button.id = name;
      button.addEventListener("click", () => ask(name));
    }
    $("requests").hidden = false;
  }
  const source = new EventSource("/events");
  source.onmessage = e => { connected = true; take(JSON.parse(e.data)); };
  source.onerror = () => { connected = false; dirty = true; };
  // Redraws when the page gets its first width, too, which is no resize of the window.
  new ResizeObserver(() => { dirty = true; }).observe(document.querySelector("main"));
  requestAnimationFrame(draw);
});
