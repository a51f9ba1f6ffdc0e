"use strict";
(() => {
  const S = JSON.parse(document.getElementById("scene").textContent);
  const box = document.getElementById("drawing"), slider = document.getElementById("pose");
  const L = S.units.length, reach = S.reach, flat = S.flat, [first, second] = S.machines;
  const order = S.order, narrow = () => window.innerWidth < 600;
  const sum = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0]];
  const size = (a) => Math.sqrt(dot(a, a));
  const unit = (a) => a.map((v) => v / (size(a) || 1));
  const middle = (a, b) => a.map((v, i) => (v + b[i]) / 2);
  // plotly reads tags and entities in what it writes
  const safe = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;")
    .replace(/>/g, "&gt;");
  const num = (v) => {
    const text = Number(v.toPrecision(6));
    return Math.abs(text) < 1e-9 * reach ? "0" : String(text).replace("-", "\u2212");
  };
  const place = (p) => (flat ? p.slice(0, 2) : p).map(num).join(", ") + " " + L;
  const colour = (name) => getComputedStyle(document.documentElement)
    .getPropertyValue("--" + name).trim();

  // of the second machine, differences from the first are magnified
  const grow = (a, b) => (typeof a === "number" ? a + S.magnification * (b - a)
    : a.map((v, i) => grow(v, b[i])));
  function magnified(one, two) {
    const limbs = one.limbs.map((limb, i) => {
      const other = two.limbs[i], out = { ...other };
      for (const key of ["base", "platform", "joints", "links", "drive", "zero"])
        if (limb[key] && other[key] && limb[key].length === other[key].length)
          out[key] = grow(limb[key], other[key]);
      return out;
    });
    return { ...two, limbs };
  }

  // --- traces: several pieces of one kind are one trace, with gaps between them -----------------
  class Pieces {
    constructor(name, more) { this.name = name; this.more = more; this.points = []; this.texts = []; }
    add(points, texts) {
      points.forEach((p, i) => {
        this.points.push(p);
        this.texts.push(Array.isArray(texts) ? texts[i] : texts || "");
      });
      this.points.push([null, null, null]);
      this.texts.push("");
      return this;
    }
    trace() {
      const out = { type: flat ? "scatter" : "scatter3d", name: this.name, mode: "lines",
        x: this.points.map((p) => p[0]), y: this.points.map((p) => p[1]), hovertext: this.texts,
        hoverinfo: this.texts.some((t) => t) ? "text" : "skip", connectgaps: false, ...this.more };
      if (!flat) out.z = this.points.map((p) => p[2]);
      return out;
    }
  }
  const width = (w) => (flat ? w : w * 1.6);

  function arrow(pieces, from, direction, text, length = 0.05 * reach) {
    const d = unit(direction), tip = sum(from, d, length);
    let side = flat ? [-d[1], d[0], 0] : cross(d, Math.abs(d[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]);
    side = unit(side);
    const foot = sum(tip, d, -0.3 * length);
    pieces.add([from, tip, sum(foot, side, 0.14 * length), tip, sum(foot, side, -0.14 * length)],
      text);
  }

  function arc(centre, zero, axis, angle) {
    const r = sum(zero, centre, -1), reached = Math.max(-2 * Math.PI, Math.min(2 * Math.PI, angle));
    const up = dot(axis, r), along = axis.map((a) => a * up), out = sum(r, along, -1);
    const across = cross(axis, out), steps = Math.max(8, Math.ceil(Math.abs(reached) * 12));
    const at = (t) => out.map((v, i) => centre[i] + 0.45 * (Math.cos(t) * v + Math.sin(t) * across[i]));
    return [...Array(steps + 1).keys()].map((k) => at(reached * k / steps))
      .concat([at(reached)]).slice(0, steps + 1);
  }

  const symbols = flat
    ? { R: "circle", P: "square", U: "diamond", S: "circle-open", "": "x" }
    : { R: "circle", P: "square", U: "diamond", S: "circle-open", "": "x" };
  const words = { R: "revolute R", P: "prismatic P", U: "universal U", S: "ball S", "": "joint" };

  function jointPlace(limb, placed, j) {
    // several joints may have one centre: a slide is shown at the middle of what slides
    if (limb.joints[j].kind !== "P") return placed.joints[j];
    const role = limb.joints[j].driven ? "drive" : "guide";
    const k = limb.links.findIndex((link) => link.role === role);
    return k < 0 ? placed.joints[j] : middle(...placed.links[k]);
  }

  function machineTraces(machine, frame, over) {
    const main = over ? colour("second") : colour("bar"), suffix = over ? " (" + safe(machine.name) + ")" : "";
    const line = (c, w, dash) => ({ line: { color: c, width: width(w), ...(dash && { dash }) } });
    const bars = new Pieces("bars" + suffix, line(main, over ? 1.5 : 4));
    const drives = new Pieces("driven slides" + suffix, line(over ? main : colour("drive"), over ? 1.5 : 5));
    const guides = new Pieces("passive slides" + suffix, line(over ? main : colour("guide"), over ? 1 : 2.5, "dash"));
    const platform = new Pieces("platform" + suffix, line(over ? main : colour("platform"), over ? 1.5 : 3));
    const out = [bars, drives, guides, platform];
    const by = { bar: bars, drive: drives, guide: guides };
    machine.limbs.forEach((limb, i) => frame.limbs[i].links.forEach(([a, b], k) => {
      const link = limb.links[k], long = size(sum(b, a, -1));
      by[link.role].add([a, middle(a, b), b], `<b>${safe(limb.name)}</b> ${safe(limb.kind)}<br>` +
        `${safe(link.role === "guide" ? "passive slide" : link.name)}: ${num(long)} ${L} long`);
    }));
    const corners = machine.platform_outline.map((i) => frame.limbs[i].platform);
    const names = machine.platform_outline.map((i) => `<b>platform, ${safe(machine.limbs[i].name)}` +
      `</b><br>${place(frame.limbs[i].platform)}`);
    if (flat && !over) Object.assign(platform.more, { fill: "toself", fillcolor: colour("platform") + "30" });
    platform.add([...corners, corners[0]], [...names, names[0]]);
    if (!flat && !over && corners.length > 2)
      out.push({ trace: () => ({ type: "mesh3d", x: corners.map((p) => p[0]), hoverinfo: "skip",
        y: corners.map((p) => p[1]), z: corners.map((p) => p[2]), opacity: 0.25, showlegend: false,
        color: colour("platform"), i: corners.slice(2).map(() => 0), j: corners.slice(2).map((_, k) => k + 1),
        k: corners.slice(2).map((_, k) => k + 2), lighting: { ambient: 1, diffuse: 0 } }), points: corners });
    return out.filter((p) => p.points.length).map((p) => p.trace());
  }

  function jointTraces(frame) {
    const groups = {};
    first.limbs.forEach((limb, i) => limb.joints.forEach((joint, j) => {
      const at = jointPlace(limb, frame.limbs[i], j), key = joint.kind + joint.driven;
      groups[key] = groups[key] || { joint, points: [], texts: [] };
      groups[key].points.push(at);
      groups[key].texts.push(`<b>${safe(limb.name)}</b> joint ${joint.number}: ${words[joint.kind] || safe(joint.kind)}` +
        (joint.driven ? `, driven by ${safe(limb.actuator)}` : "") + `<br>${place(frame.limbs[i].joints[j])}`);
    }));
    return Object.values(groups).map(({ joint, points, texts }) => {
      const ink = joint.driven ? colour("drive") : colour("bar");
      const pieces = new Pieces((words[joint.kind] || safe(joint.kind)) + (joint.driven ? ", driven" : ""), {
        mode: "markers", marker: { symbol: symbols[joint.kind] || "x", size: flat ? 12 : 6, color: ink,
          line: { color: flat && joint.kind !== "S" ? colour("card") : ink, width: flat ? 1.5 : 1 } } });
      points.forEach((p, i) => pieces.add([p], texts[i]));
      return pieces.trace();
    });
  }

  function driveTraces(frame) {
    const plus = new Pieces("direction of +u", { line: { color: colour("drive"), width: width(2) } });
    const zero = new Pieces("u from its zero", { line: { color: colour("drive"), width: width(1.2), dash: "dot" } });
    const travel = new Pieces("travel (limits)", { line: { color: colour("soft"), width: width(1.2), dash: "dot" } });
    first.limbs.forEach((limb, i) => {
      const p = frame.limbs[i];
      if (!p.drive) return;
      const k = limb.links.findIndex((link) => link.role === "drive");
      const said = `<b>${safe(limb.actuator)}</b>: u = ${num(p.u)} ${limb.slides ? L : S.units.angle}`;
      if (limb.slides) {
        const end = p.links[k][1];
        arrow(plus, end, p.drive_axis, said + ", grows this way");
        const ends = limb.travel && limb.travel.map((u) => sum(p.drive, p.drive_axis, u));
        if (ends) travel.add(ends, limb.travel.map((u) => `<b>${safe(limb.actuator)}</b> limit: u = ${num(u)} ${L}`));
      } else {
        const angle = S.units.angle === "deg" ? p.u * Math.PI / 180 : p.u;
        const curve = arc(p.drive, p.zero, p.drive_axis, angle), last = curve[curve.length - 1];
        zero.add([p.drive, p.zero], `<b>${safe(limb.actuator)}</b>: u = 0 here`);
        zero.add(curve, said);
        const out = sum(last, p.drive, -1);
        if (size(cross(p.drive_axis, out)) > 0) arrow(plus, last, cross(p.drive_axis, out), said + ", grows this way", 0.04 * reach);
      }
    });
    return [zero, travel, plus].filter((p) => p.points.length).map((p) => p.trace());
  }

  function axisTraces(frame) {
    const out = [], length = 0.12 * reach;
    [["base", [0, 0, 0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]], ["platform", frame.origin, frame.axes]]
      .forEach(([name, origin, axes], body) => axes.slice(0, flat ? 2 : 3).forEach((axis, k) => {
        const letter = "xyz"[k], tip = sum(origin, axis, length);
        const pieces = new Pieces(name + " axes", { mode: "lines+text", text: ["", letter],
          textposition: "top center", textfont: { color: colour(letter), size: 13 },
          line: { color: colour(letter), width: width(2) }, legendgroup: name, showlegend: k === 0 });
        pieces.add([origin, tip], [`<b>${name} origin</b><br>${place(origin)}`, `${name} ${letter}`]);
        out.push(pieces.trace());
      }));
    return out;
  }

  function bodyTraces(frame, home) {
    const out = [], limbs = frame.limbs;
    const base = new Pieces("base", { line: { color: colour("base"), width: width(1.5), dash: "dot" } });
    const corners = first.base_outline.map((i) => limbs[i].base);
    base.add([...corners, corners[0]], first.base_outline.map((i) => `<b>base, ${safe(first.limbs[i].name)}</b><br>` +
      place(limbs[i].base)).concat([""]));
    out.push(base.trace());
    if (frame !== home) {
      const ghost = new Pieces("platform at home", { line: { color: colour("platform"), width: width(1.2), dash: "dot" } });
      const at = first.platform_outline.map((i) => home.limbs[i].platform);
      out.push(ghost.add([...at, at[0]], "platform at home").trace());
    }
    const names = new Pieces("names", { mode: "markers+text", textposition: "bottom center",
      marker: { size: flat ? 18 : 6, opacity: 0 },
      textfont: { color: colour("ink"), size: narrow() ? 11 : 13 }, showlegend: false });
    first.limbs.forEach((limb, i) => names.add([limbs[i].base], `<b>${safe(limb.name)}</b> ${safe(limb.kind)}<br>` + place(limbs[i].base)));
    names.more.text = first.limbs.flatMap((limb) => [safe(limb.name), ""]);
    out.push(names.trace());
    const open = new Pieces("does not close", { line: { color: colour("out"), width: width(4) } });
    first.limbs.forEach((limb, i) => {
      const p = limbs[i], last = p.links.length ? p.links[p.links.length - 1][1] : p.base;
      if (p.gap > 1e-6 * reach) open.add([last, p.platform], `<b>${safe(limb.name)}</b> does not close: ${num(p.gap)} ${L}`);
    });
    if (open.points.length) out.push(open.trace());
    return out;
  }

  function measuredTraces() {
    if (!S.measured.length) return [];
    const valued = S.measured.some((m) => m.value != null);
    const said = S.measured.map((m) => `<b>${safe(m.label)}</b><br>${place(m.point)}` +
      (m.value == null ? "" : `<br>${safe(S.value)} ${num(m.value)} ${safe(S.value_unit)}`));
    const points = new Pieces("measured poses", { mode: "markers", marker: { size: flat ? 8 : 4, color: valued
      ? S.measured.flatMap((m) => [m.value == null ? 0 : m.value, 0]) : colour("z"),
      ...(valued && { colorscale: "Viridis", cmin: Math.min(...S.measured.map((m) => m.value || 0)),
        cmax: Math.max(...S.measured.map((m) => m.value || 0)),
        colorbar: { title: { text: safe(`${S.value} ${S.value_unit}`) }, thickness: 12, tickfont: { color: colour("soft") } } }) } });
    S.measured.forEach((m, i) => points.add([m.point], said[i]));
    const errors = new Pieces(`errors, ${num(S.magnification)} times`, { line: { color: colour("out"), width: width(1.5) } });
    S.measured.forEach((m, i) => {
      if (m.error && size(m.error) > 0) arrow(errors, m.point, m.error, said[i], S.magnification * size(m.error));
    });
    return [errors, points].filter((p) => p.points.length).map((p) => p.trace());
  }

  // --- where all of it is, so that the view stands still while the machine moves ----------------
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const see = (p) => p && p.forEach((v, k) => { low[k] = Math.min(low[k], v); high[k] = Math.max(high[k], v); });
  first.frames.forEach((frame) => {
    [[0, 0, 0], frame.origin, ...frame.axes.map((a) => sum(frame.origin, a, 0.12 * reach))].forEach(see);
    frame.limbs.forEach((limb) => [limb.base, limb.platform, limb.zero, ...limb.joints, ...limb.links.flat()].forEach(see));
  });
  first.limbs.forEach((limb, i) => limb.travel && limb.links[0] && first.frames.slice(0, 1).forEach((frame) =>
    limb.travel.forEach((u) => see(sum(frame.limbs[i].drive, frame.limbs[i].drive_axis, u)))));
  S.measured.forEach((m) => see(m.point));
  const pad = 0.06 * Math.max(...high.map((v, k) => v - low[k]), reach / 2);
  const range = low.map((v, k) => [v - pad, high[k] + pad]);
  const span = range.map(([a, b]) => b - a);
  // so that the whole box is seen from everywhere, also where the page is higher than wide
  const fits = () => Math.min(2.35 / size(span), 1.95 / (0.92 * span[2] + 0.38 * Math.hypot(span[0],
    span[1]))) * Math.min(1, box.clientWidth / (0.9 * box.clientHeight));
  const views = { all: [1.15, -1.55, 0.8], x: [2, 0, 0], y: [0, -2, 0], z: [0, -1e-3, 2] };

  function layout() {
    const axis = (k) => ({ title: { text: `${"xyz"[k]} [${L}]` }, range: range[k], gridcolor: colour("grid"),
      zerolinecolor: colour("line"), color: colour("soft"), tickfont: { size: narrow() ? 10 : 12 },
      ...(!flat && { showbackground: false, showspikes: false, nticks: narrow() ? 4 : 7 }) });
    const out = { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", uirevision: "kept",
      font: { color: colour("ink"), size: narrow() ? 11 : 13, family: "system-ui, sans-serif" },
      margin: flat ? { l: 56, r: 12, t: 30, b: 44 } : { l: 0, r: 0, t: 0, b: 0 }, hovermode: "closest",
      hoverlabel: { bgcolor: colour("card"), bordercolor: colour("line"), font: { color: colour("ink") }, align: "left" },
      legend: { orientation: "h", x: 0, y: flat ? (narrow() ? -0.24 : -0.17) : 0, yanchor: "top",
        font: { size: narrow() ? 11 : 12 }, itemsizing: "constant",
        ...(narrow() && { entrywidth: 0.48, entrywidthmode: "fraction" }), bgcolor: "rgba(0,0,0,0)" },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("soft"), activecolor: colour("ink") } };
    if (flat) return { ...out, dragmode: "pan", xaxis: axis(0), yaxis: { ...axis(1), scaleanchor: "x", scaleratio: 1 } };
    return { ...out, scene: { xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: "manual",
      aspectratio: { x: span[0] * fits(), y: span[1] * fits(), z: span[2] * fits() }, camera: camera("all") } };
  }
  const camera = (view) => ({ eye: { x: views[view][0], y: views[view][1], z: views[view][2] },
    up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 }, projection: { type: "orthographic" } });

  function cell(row, text, kind, head) {
    const made = document.createElement(head ? "th" : "td");
    made.textContent = text;
    if (kind) made.className = kind;
    row.append(made);
  }
  function table(id, caption, heads, rows) {
    const place = document.getElementById(id);
    place.textContent = "";
    place.createCaption().textContent = caption;
    const head = place.createTHead().insertRow();
    heads.forEach((h, i) => cell(head, h, i ? "n" : "", true));
    const body = place.createTBody();
    rows.forEach((r) => { const row = body.insertRow(); r.forEach((t, i) => cell(row, t, i ? "n" : "", !i)); });
  }
  const signed = (v) => (v > 0 ? "+" : "") + num(v);

  function draw() {
    const n = order[+slider.value], frame = first.frames[n], home = first.frames[0];
    document.getElementById("label").value = frame.label;
    slider.setAttribute("aria-valuetext", frame.label);
    const traces = [...bodyTraces(frame, home), ...driveTraces(frame), ...machineTraces(first, frame, false),
      ...(second ? machineTraces(second, magnified(frame, second.frames[n]), true) : []),
      ...jointTraces(frame), ...axisTraces(frame), ...measuredTraces()];
    const change = (a, b) => (Math.abs(a - b) < 1e-9 * Math.max(1, Math.abs(b)) ? "0" : signed(a - b));
    table("coordinates", "Platform", ["pose", "value", "from home", "unit"], S.coordinates.map((c, i) =>
      [c, num(frame.pose[i]), change(frame.pose[i], home.pose[i]), S.coordinate_units[i]]));
    table("joints", "Joint values", ["joint", "q", "from home", "unit"], S.actuators.map((a, i) =>
      [a, num(frame.q[i]), change(frame.q[i], home.q[i]), S.joint_units[i] || "(bare)"]));
    return Plotly.react(box, traces, layout(), { responsive: true, displaylogo: false,
      modeBarButtons: [flat
      ? ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]
      : ["toImage", "zoom3d", "pan3d", "orbitRotation", "tableRotation", "resetCameraDefault3d"]] });
  }

  const home = order.indexOf(0);
  const go = (n) => { slider.value = n; draw(); };
  slider.addEventListener("input", draw);
  document.getElementById("back").addEventListener("click", () => go(+slider.value - 1));
  document.getElementById("next").addEventListener("click", () => go(+slider.value + 1));
  document.getElementById("home").addEventListener("click", () => go(home));
  if (!flat) {
    const bar = document.getElementById("views");
    bar.hidden = false;
    bar.addEventListener("click", (event) => {
      const view = event.target.dataset.view;
      if (view) Plotly.relayout(box, { "scene.camera": camera(view) });
    });
  }
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw().then(() => box.setAttribute("data-drawn", String(box.data.length)));
})();
