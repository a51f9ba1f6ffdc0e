"use strict";
// the machine at one pose: limbs, joints, drives, bodies, what is lit and what needs a look
((M) => {
  const symbols = { R: "circle", P: "square", U: "diamond", S: "circle-open", "": "square-open" };
  const words = { R: "revolute R", P: "prismatic P", U: "universal U", S: "ball S", "": "joint" };
  const { safe, sum, size, middle } = M;
  const made = (pieces) => pieces.filter((p) => p.points.length).map((p) => p.trace());
  const outline = (pieces, points, texts) => pieces.add([...points, points[0]],
    texts ? [...texts, texts[0]] : undefined);
  const lineOf = (placed) => (placed.links.length
    ? [placed.links[0][0], ...placed.links.map((k) => k[1])] : [placed.base, placed.platform]);

  // of the second machine, differences from the first are magnified
  M.magnified = (one, two, factor) => {
    const grow = (a, b) => (typeof a === "number" ? a + factor * (b - a)
      : a.map((v, i) => grow(v, b[i])));
    const limbs = one.limbs.map((limb, i) => {
      const other = two.limbs[i], out = { ...other };
      for (const key of ["base", "platform", "joints", "links", "drive", "zero"])
        if (limb[key] && other[key] && limb[key].length === other[key].length)
          out[key] = grow(limb[key], other[key]);
      return out;
    });
    return { ...two, limbs };
  };

  function jointPlace(limb, placed, j) {
    // several joints may have one centre: a slide is shown at the middle of what slides
    if (limb.joints[j].kind !== "P") return placed.joints[j];
    const role = limb.joints[j].driven ? "drive" : "guide";
    const k = limb.links.findIndex((link) => link.role === role);
    return k < 0 ? placed.joints[j] : middle(...placed.links[k]);
  }

  M.machineTraces = (c, machine, frame, over) => {
    const suffix = over ? ` (${safe(machine.name)}, \u00d7 ${M.digits(c.scene.magnification)})` : "";
    const ink = (name) => c.colour(over ? "second" : name);
    const bars = c.pieces("bars" + suffix, c.line(ink("bar"), over ? 1.5 : 4));
    const drives = c.pieces("driven slides" + suffix, c.line(ink("drive"), over ? 1.5 : 5));
    const guides = c.pieces("passive slides" + suffix, c.line(ink("guide"), over ? 1 : 2.5, "dash"));
    const platform = c.pieces("platform" + suffix, c.line(ink("platform"), over ? 1.5 : 3));
    const by = { bar: bars, drive: drives, guide: guides };
    machine.limbs.forEach((limb, i) => frame.limbs[i].links.forEach(([a, b], k) => {
      const link = limb.links[k], what = link.role === "guide" ? "passive slide" : link.name;
      by[link.role].add([a, middle(a, b), b], `<b>${safe(limb.name)}</b> ${safe(limb.kind)}<br>` +
        `${safe(what)}: ${c.num(size(sum(b, a, -1)))} ${c.L} long`);
    }));
    const corners = machine.platform_outline.map((i) => frame.limbs[i].platform);
    if (c.flat && !over)
      Object.assign(platform.more, { fill: "toself", fillcolor: c.colour("platform", 0.19) });
    outline(platform, corners, machine.platform_outline.map((i) =>
      `<b>platform, ${safe(machine.limbs[i].name)}</b><br>${c.place(frame.limbs[i].platform)}`));
    // over another one: one entry of the legend, and one click, for all of it
    const parts = [bars, drives, guides, platform].filter((p) => p.points.length);
    if (over) parts.forEach((p, n) => {
      p.name = suffix.slice(2, -1);
      Object.assign(p.more, { legendgroup: "over", showlegend: n === 0 });
    });
    const out = made(parts);
    if (!c.flat && !over && corners.length > 2)
      out.push({ type: "mesh3d", x: corners.map((p) => p[0]), hoverinfo: "skip", name: "plate",
        y: corners.map((p) => p[1]), z: corners.map((p) => p[2]), opacity: 0.25, showlegend: false,
        color: c.colour("platform"), i: corners.slice(2).map(() => 0),
        j: corners.slice(2).map((_, k) => k + 1), k: corners.slice(2).map((_, k) => k + 2),
        lighting: { ambient: 1, diffuse: 0 } });
    return out;
  };

  M.jointTraces = (c, machine, frame) => {
    const groups = {};
    machine.limbs.forEach((limb, i) => (limb.joints ?? []).forEach((joint, j) => {
      const key = joint.kind + joint.driven, own = groups[key] || { joint, points: [], texts: [] };
      groups[key] = own;
      own.points.push(jointPlace(limb, frame.limbs[i], j));
      own.texts.push(`<b>${safe(limb.name)}</b> joint ${joint.number}: ` +
        (words[joint.kind] || safe(joint.kind)) + (joint.driven ? `, driven by ${safe(limb.actuator)}`
        : "") + `<br>${c.place(frame.limbs[i].joints[j])}`);
    }));
    return Object.values(groups).map(({ joint, points, texts }) => {
      const ink = c.colour(joint.driven ? "drive" : "bar");
      const rim = c.flat && joint.kind !== "S" ? c.colour("card") : ink;
      const pieces = c.pieces((words[joint.kind] || safe(joint.kind)) + (joint.driven ? ", driven" : ""), {
        mode: "markers", marker: { symbol: symbols[joint.kind] || "square-open", size: c.flat ? 12 : 6,
          color: ink, line: { color: rim, width: c.flat ? 1.5 : 1 } } });
      points.forEach((p, i) => pieces.add([p], texts[i]));
      return pieces.trace();
    });
  };

  M.driveTraces = (c, machine, frame) => {
    const plus = c.pieces("direction of +u", c.line(c.colour("drive"), 2));
    const zero = c.pieces("u from its zero", c.line(c.colour("drive"), 1.2, "dot"));
    const travel = c.pieces("travel (limits)", c.line(c.colour("soft"), 1.2, "dot"));
    machine.limbs.forEach((limb, i) => {
      const p = frame.limbs[i], name = `<b>${safe(limb.actuator)}</b>`;
      if (!p.drive) return;
      const said = `${name}: u = ${c.num(p.u)} ${limb.slides ? c.L : c.scene.units.angle}`;
      if (limb.slides) {
        const k = limb.links.findIndex((link) => link.role === "drive");
        M.arrow(c, plus, p.links[k][1], p.drive_axis, said + ", grows this way", 0.05 * c.reach);
        if (limb.travel) travel.add(limb.travel.map((u) => sum(p.drive, p.drive_axis, u)),
          limb.travel.map((u) => `${name} limit: u = ${c.num(u)} ${c.L}`));
        return;
      }
      const curve = M.arc(p.drive, p.zero, p.drive_axis,
        c.scene.units.angle === "deg" ? p.u * Math.PI / 180 : p.u);
      zero.add([p.drive, p.zero], `${name}: u = 0 here`);
      zero.add(curve, said);
      const last = curve[curve.length - 1], ahead = M.cross(p.drive_axis, sum(last, p.drive, -1));
      if (size(ahead) > 0) M.arrow(c, plus, last, ahead, said + ", grows this way", 0.04 * c.reach);
    });
    return made([zero, travel, plus]);
  };

  M.axisTraces = (c, frame) => {
    const bodies = [["base", [0, 0, 0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]],
      ["platform", frame.origin, frame.axes]];
    return bodies.flatMap(([name, origin, axes]) => axes.slice(0, c.flat ? 2 : 3).map((axis, k) => {
      const letter = "xyz"[k], pieces = c.pieces(name + " axes", { mode: "lines+text",
        text: [k ? "" : name, letter], textposition: ["bottom center", "top center"], legendgroup: name, showlegend: k === 0,
        textfont: { color: c.colour(letter), size: 13 }, ...c.line(c.colour(letter), 2) });
      return pieces.add([origin, sum(origin, axis, 0.12 * c.reach)],
        [`<b>${name} origin</b><br>${c.place(origin)}`, `${name} ${letter}`]).trace();
    }));
  };

  M.bodyTraces = (c, machine, frame, home) => {
    const base = c.pieces("base", c.line(c.colour("base"), 1.5, "dot")), order = machine.base_outline;
    outline(base, order.map((i) => frame.limbs[i].base), order.map((i) =>
      `<b>base, ${safe(machine.limbs[i].name)}</b><br>${c.place(frame.limbs[i].base)}`));
    const ghost = c.pieces("platform at home", c.line(c.colour("platform"), 1.2, "dot"));
    if (frame !== home) outline(ghost, machine.platform_outline.map((i) => home.limbs[i].platform),
      machine.platform_outline.map(() => "platform at home"));
    const other = c.pieces("other branch", c.line(c.colour("guide"), 1.2, "dashdot"));
    if (frame === home) (machine.other || []).forEach((line, i) => line.length && other.add(line,
      `<b>${safe(machine.limbs[i].name)}</b> on its other branch`));
    const names = c.pieces("names", { mode: "markers+text", textposition: "bottom center",
      marker: { size: c.flat ? 18 : 6, opacity: 0 }, showlegend: false,
      textfont: { color: c.colour("ink"), size: c.narrow ? 11 : 13 } });
    const labels = [];
    machine.limbs.forEach((limb, i) => {
      const own = (c.scene.effects || []).filter((e) => (e.limbs || []).includes(i) &&
        e.limbs.length < machine.limbs.length).map((e) => safe(e.name.split(" on ")[0]));
      names.add([frame.limbs[i].base], `<b>${safe(limb.name)}</b> on the base<br>${c.place(frame.limbs[i].base)}`);
      labels.push(safe(limb.name) + (own.length ? `: <b>${own.join(", ")}</b>` : ""), "");
    });
    names.more.text = labels;
    return made([base, ghost, other, names]);
  };

  // effects where they sit, under the machine: one wide line in its own colour for each
  M.effectTraces = (c, machine, frame) => {
    const local = (c.scene.effects || []).some((e) => (e.limbs || []).length &&
      e.limbs.length < machine.limbs.length);
    return made((c.scene.effects || []).map((effect, n) => {
      const all = (effect.limbs || []).length === machine.limbs.length;
      const lit = c.pieces("lit: " + safe(effect.name), { ...c.line(c.colour(`lit${n % 3 + 1}`,
        c.flat ? 0.5 : 1), c.flat ? 14 : 16), opacity: c.flat ? 1 : 0.5,
      visible: all && local ? "legendonly" : true });
      (effect.limbs || []).forEach((i) => lit.add(lineOf(frame.limbs[i]),
        `<b>${safe(machine.limbs[i].name)}</b>: ${safe(effect.text)}`));
      const order = { base: machine.base_outline, platform: machine.platform_outline }[effect.body];
      if (order) outline(lit, order.map((i) => frame.limbs[i][effect.body]),
        order.map(() => safe(effect.text)));
      return lit;
    }));
  };

  // joints in one place and links that touch by design need no look
  M.marks = (frame) => (frame.marks || []).filter(
    (mark) => !["shared", "touching"].includes(mark.kind));

  // what needs a look: limbs in red, the gap of one that is open, places where two meet
  M.markTraces = (c, machine, frame) => {
    const limbs = c.pieces("needs a look", c.line(c.colour("out"), 2.5, "dash"));
    const gaps = c.pieces("does not close", c.line(c.colour("out"), 6));
    const places = c.pieces("too near, or open", { mode: "markers", marker: { symbol: "circle-open",
      size: c.flat ? 22 : 12, color: c.colour("out"), line: { color: c.colour("out"), width: 3 } } });
    M.marks(frame).forEach((mark) => {
      if (mark.kind !== "gap") (mark.limbs || []).forEach((i) =>
        limbs.add(lineOf(frame.limbs[i]), safe(mark.text)));
      else mark.limbs.forEach((i) => gaps.add(frame.limbs[i].gap_ends, safe(mark.text)));
      (mark.points || []).forEach((p) => places.add([p], safe(mark.text)));
    });
    return made([limbs, gaps, places]);
  };
})(window.PpmcalMachine = window.PpmcalMachine || {});
