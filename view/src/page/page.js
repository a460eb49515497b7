// Page of a recording: builds its parts and plays the motion.

addEventListener("DOMContentLoaded", () => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = id => document.getElementById(id);
  for (const name of ["q", "q_d", "qd", "qd_d", "tau"]) data[name] = data[name].map(numbers);
  const { t, q, q_d: desired, modes } = data;
  const [begin, end] = [t[0], t[t.length - 1]];
  // Starts at the first plan, where the motion begins.
  let now = Math.max(begin, Math.min(0, end)), playing = false, last = 0;

  // Interval of samples around time s: indices of its ends, and the share of the interval that has passed.
  const place = s => {
    let [a, b] = [0, t.length - 1];
    while (b - a > 1) { const m = (a + b) >> 1; if (t[m] <= s) a = m; else b = m; }
    return [a, b, b > a ? Math.max(0, Math.min(1, (s - t[a]) / (t[b] - t[a]))) : 0];
  };
  const at = (column, [a, b, s]) => column[a] + (column[b] - column[a]) * s;
  const modeAt = s => [...modes].reverse().find(m => m.from <= s) || modes[0];
  const isMoving = name => name === "track" || name === "balance";

  const rows = (table, entries, cell = "td") => entries.forEach(([name, ...values]) => {
    const row = $(table).insertRow();
    const head = row.appendChild(document.createElement("th"));
    head.textContent = name;
    values.forEach(v => { row.appendChild(document.createElement(cell)).textContent = v; });
  });
  document.title = `${data.name} - upswing`;
  $("name").textContent = data.name;
  $("about").textContent = `upswing ${data.details.version || ""}, model ${data.details.model_fingerprint || "unknown"}`;
  rows("summary", data.summary);
  rows("details", Object.entries(data.details));
  if (data.times.length) rows("percentiles", [["us", "p50", "p99", "p99.9", "max"]], "th");
  rows("percentiles", data.times.map(d => [d.name, ...d.percentiles.map(v => v.toFixed(1))]));
  for (const [name, fingerprint, text] of data.settings) {
    const details = $("settings").appendChild(document.createElement("details"));
    const summary = details.appendChild(document.createElement("summary"));
    summary.textContent = name;
    summary.appendChild(document.createElement("code")).textContent = fingerprint;
    details.appendChild(document.createElement("pre")).textContent = text;
  }

  // Indices of the samples of each time span that follows a plan.
  const parts = modes.filter(m => isMoving(m.name)).map(m => t.map((_, i) => i).filter(i => t[i] >= m.from && t[i] < m.to));
  const scaled = (column, limit) => column.map(v => v / limit);
  const panels = [];
  for (let first = 0; first < data.joints.length; first += COLOURS.length) {
    const joints = data.joints.slice(first, first + COLOURS.length).map((joint, k) => ({ ...joint, index: first + k, colour: COLOURS[k] }));
    const panel = (title, place, values, wanted, limits) => {
      const curves = joints.filter(joint => place(joint) !== null).map(joint => ({
        label: joint.name, colour: joint.colour, values: scaled(values[place(joint)], limits[place(joint)]),
        desired: wanted && scaled(wanted[place(joint)], limits[place(joint)]), parts,
      }));
      panels.push(new Panel($("panels"), title, t, curves, seek));
    };
    panel("position", joint => joint.index, q, desired, data.limits.q);
    panel("velocity", joint => joint.index, data.qd, data.qd_d, data.limits.qd);
    panel(effort(joints), joint => joint.motor, data.tau, null, data.limits.tau);
  }

  const scene = new Scene($("scene"), data.links, data.joints, draw);
  for (let k = 0; k <= 40; k++) scene.fit(q.map(column => at(column, place(begin + (end - begin) * k / 40))));
  const scrub = $("scrub");
  Object.assign(scrub, { min: begin, max: end, step: 0.001 });

  function draw() {
    const where = place(now), mode = modeAt(now).name;
    const angles = columns => columns.map(column => at(column, where));
    const trail = [];
    for (let s = Math.max(begin, now - 1); s < now; s += 0.02) trail.push(scene.tip(q.map(c => at(c, place(s)))));
    trail.push(scene.tip(angles(q)));
    scene.draw(angles(q), isMoving(mode) ? angles(desired) : null, trail);
    $("readout").textContent = [`mode ${mode}`, ...freeJoints(data.joints, i => at(q[i], where))].join("\n");
    $("clock").textContent = `${now.toFixed(3)} s`;
    scrub.value = now;
    panels.forEach(panel => panel.draw(now, column => at(column, where)));
    drawTimeline($("timeline"), modes, data.late, begin, end, now);
  }

  function seek(s) { now = Math.max(begin, Math.min(end, s)); draw(); }

  function play(on) {
    playing = on;
    $("play").textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (now >= end) now = begin;
    last = performance.now();
    requestAnimationFrame(step);
  }

  function step(moment) {
    if (!playing) return;
    const passed = Math.max(0, moment - last) / 1000 * Number($("speed").value);
    last = moment;
    seek(now + passed);
    if (now >= end) play(false); else requestAnimationFrame(step);
  }

  function resize() {
    panels.forEach(panel => panel.render());
    drawTimes($("times"), data.times, data.period_us);
    draw();
  }

  $("play").addEventListener("click", () => play(!playing));
  scrub.addEventListener("input", () => { play(false); seek(Number(scrub.value)); });
  $("timeline").addEventListener("pointerdown", e => seek(begin + e.offsetX / $("timeline").clientWidth * (end - begin)));
  // A control focused by Tab keeps its own keys; after a click, the keys belong to the page.
  let tabbed = false;
  addEventListener("pointerdown", () => { tabbed = false; }, true);
  addEventListener("keydown", e => {
    if (e.key === "Tab") tabbed = true;
    if (e.ctrlKey || e.altKey || e.metaKey) return;
    if (tabbed && e.target.closest("input, select, button, summary")) return;
    const act = { " ": () => play(!playing), ArrowRight: () => seek(now + 0.02), ArrowLeft: () => seek(now - 0.02) }[e.key];
    // The focused play button takes the space bar as a click itself.
    if (!act || (e.key === " " && e.target === $("play"))) return;
    e.preventDefault();
    act();
  });
  // Also called once when the observation starts, and when the page gets its first width, which is no resize of the window.
  new ResizeObserver(resize).observe(document.querySelector("main"));
  resize();
});
