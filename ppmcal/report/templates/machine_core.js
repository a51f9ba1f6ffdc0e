"use strict";
// what every part of a drawing of a machine uses: vectors, words, colours, pieces of lines
((M) => {
  M.sum = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
  M.dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  M.cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0]];
  M.size = (a) => Math.sqrt(M.dot(a, a));
  M.unit = (a) => a.map((v) => v / (M.size(a) || 1));
  M.middle = (a, b) => a.map((v, i) => (v + b[i]) / 2);
  // plotly reads tags and entities in what it writes
  M.safe = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;")
    .replace(/>/g, "&gt;");
  M.minus = (text) => String(text).replace("-", "\u2212");
  M.digits = (v, n = 4) => (v === null || v === undefined ? "\u2013" : M.minus(Number(v.toPrecision(n))));

  // several pieces of one kind are one trace, with gaps between them
  M.Pieces = class {
    constructor(flat, name, more) {
      Object.assign(this, { flat, name, more, points: [], texts: [], keys: [] });
    }
    add(points, texts, key = null) {
      points.forEach((p, i) => {
        this.points.push(p);
        this.texts.push(Array.isArray(texts) ? texts[i] : texts || "");
        this.keys.push(key);
      });
      this.points.push([null, null, null]);
      this.texts.push("");
      this.keys.push(null);
      return this;
    }
    trace() {
      const out = { type: this.flat ? "scatter" : "scatter3d", name: this.name, mode: "lines",
        x: this.points.map((p) => p[0]), y: this.points.map((p) => p[1]), hovertext: this.texts,
        hoverinfo: this.texts.some((t) => t) ? "text" : "skip", connectgaps: false, ...this.more };
      if (!this.flat) out.z = this.points.map((p) => p[2]);
      if (this.keys.some((k) => k !== null)) out.customdata = this.keys;
      return out;
    }
  };

  // colours are those of the style sheet, resolved: light, dark or on paper
  M.palette = (root) => {
    const probe = document.createElement("i"), known = {};
    root.append(probe);
    "card ink soft line grid bar drive guide base platform second out pick x y z lit1 lit2 lit3"
      .split(" ").forEach((name) => {
        probe.style.color = `var(--m-${name})`;
        known[name] = getComputedStyle(probe).color;
      });
    probe.remove();
    return (name, opacity = 1) => (opacity === 1 ? known[name]
      : known[name].replace(/^rgba?\(([^,]+),([^,]+),([^,)]+).*\)$/, `rgba($1,$2,$3,${opacity})`));
  };

  // what one drawing of one scene knows, made anew for each: data, colours, words
  M.context = (scene, root) => {
    const flat = scene.flat, L = scene.units.length;
    const num = (v) => (Math.abs(v) < 1e-9 * scene.reach ? "0" : M.digits(v, 6));
    return { scene, flat, L, reach: scene.reach, num, colour: M.palette(root),
      narrow: root.clientWidth < 560, width: (w) => (flat ? w : w * 1.6),
      place: (p) => (flat ? p.slice(0, 2) : p).map(num).join(", ") + " " + L,
      pieces: (name, more) => new M.Pieces(flat, name, more),
      line: (c, w, dash) => ({ line: { color: c, width: flat ? w : w * 1.6, ...(dash && { dash }) } }) };
  };

  M.arrow = (c, pieces, from, direction, text, length, key = null) => {
    const d = M.unit(direction), tip = M.sum(from, d, length);
    let side = c.flat ? [-d[1], d[0], 0] : M.cross(d, Math.abs(d[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]);
    side = M.unit(side);
    const foot = M.sum(tip, d, -0.3 * length);
    pieces.add([from, tip, M.sum(foot, side, 0.14 * length), tip,
      M.sum(foot, side, -0.14 * length)], text, key);
  };

  M.arc = (centre, zero, axis, angle) => {
    const r = M.sum(zero, centre, -1), most = Math.max(-2 * Math.PI, Math.min(2 * Math.PI, angle));
    const up = M.dot(axis, r), along = axis.map((a) => a * up), out = M.sum(r, along, -1);
    const over = M.cross(axis, out), steps = Math.max(8, Math.ceil(Math.abs(most) * 12));
    return [...Array(steps + 1).keys()].map((k) => {
      const t = most * k / steps;
      return out.map((v, i) => centre[i] + 0.45 * (Math.cos(t) * v + Math.sin(t) * over[i]));
    });
  };
})(window.PpmcalMachine = window.PpmcalMachine || {});
