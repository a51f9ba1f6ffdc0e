"use strict";
// every drawing of a machine on the page: drawn when it comes near, moved by its slider
((M) => {
  const views = { all: [1.15, -1.55, 0.8], x: [2, 0, 0], y: [0, -2, 0], z: [0, -1e-3, 2] };
  const camera = (view) => ({ eye: { x: views[view][0], y: views[view][1], z: views[view][2] },
    up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 }, projection: { type: "orthographic" } });
  const LINE = 27;    // px, of a legend in two columns
  const MOST_ALIVE = 6;    // a browser keeps few 3D drawings at once

  class View {
    constructor(root) {
      this.root = root;
      this.find = (name) => root.querySelector(".m-" + name);
      this.scene = JSON.parse(root.querySelector("script").textContent);
      this.box = this.find("drawing");
      this.slider = this.find("pose");
      [this.first, this.second] = this.scene.machines;
      this.home = this.scene.order.indexOf(0);
      this.stage = "after";
      this.keys = [];
      this.bounds();
      this.listen();
    }

    // where all of it is, so that the view stands still while the machine moves
    bounds() {
      const reach = this.scene.reach, box = () => ({ low: [Infinity, Infinity, Infinity],
        high: [-Infinity, -Infinity, -Infinity] });
      const within = (b) => (p) => p && p.forEach((v, k) => {
        b.low[k] = Math.min(b.low[k], v);
        b.high[k] = Math.max(b.high[k], v);
      });
      const padded = ({ low, high }, part, least) => {
        const pad = part * Math.max(...high.map((v, k) => v - low[k]), least);
        return low.map((v, k) => [v - pad, high[k] + pad]);
      };
      const all = box(), rows = box(), see = within(all);
      this.first.frames.forEach((frame, n) => {
        [[0, 0, 0], frame.origin, ...frame.axes.map((a) => M.sum(frame.origin, a, 0.12 * reach))]
          .forEach(see);
        frame.limbs.forEach((limb, i) => {
          [limb.base, limb.platform, limb.zero, ...(limb.joints ?? []), ...limb.links.flat()].forEach(see);
          const travel = this.first.limbs[i].travel;
          if (n === 0 && travel && limb.drive)
            travel.forEach((u) => see(M.sum(limb.drive, limb.drive_axis, u)));
        });
      });
      (this.scene.measured || []).forEach((m) => { see(m.point); within(rows)(m.point); });
      this.whole = padded(all, 0.06, reach / 2);
      this.rows = this.scene.measured && padded(rows, 0.2, reach / 50);
    }

    // lines: of the legend, which on a phone stands below the drawing
    layout(c, lines) {
      const range = this.closer ? this.rows : this.whole, span = range.map(([a, b]) => b - a);
      const { flat, colour } = c;
      const valued = (this.scene.measured || []).length > 0;
      const axis = (k) => ({ title: { text: `${"xyz"[k]} [${M.safe(c.L)}]` }, range: range[k],
        gridcolor: colour("grid"), zerolinecolor: colour("line"), color: colour("soft"),
        tickfont: { size: c.narrow ? 10 : 12 },
        ...(!flat && { showbackground: false, showspikes: false, nticks: c.narrow ? 4 : 7 }) });
      const top = valued ? 62 : flat ? 30 : 0;
      const out = { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", uirevision: this.closer ? "rows" : "all",
        font: { color: colour("ink"), size: c.narrow ? 11 : 13, family: "system-ui, sans-serif" },
        margin: flat ? { l: 56, r: 12, t: top, b: 44 } : { l: 0, r: 0, t: top, b: 0 },
        hovermode: "closest", hoverlabel: { bgcolor: colour("card"), bordercolor: colour("line"),
          font: { color: colour("ink") }, align: "left" },
        legend: { orientation: "h", x: 0, y: flat ? (c.narrow ? -0.24 : -0.17) : 0, yanchor: "top",
          font: { size: c.narrow ? 10 : 12 }, itemsizing: "constant", bgcolor: "rgba(0,0,0,0)",
          ...(c.narrow && { entrywidth: 0.48, entrywidthmode: "fraction" }) },
        modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("soft"), activecolor: colour("ink") } };
      if (flat) return { ...out, dragmode: "pan", xaxis: axis(0),
        yaxis: { ...axis(1), scaleanchor: "x", scaleratio: 1 } };
      // so that the whole box is seen from everywhere, also where the page is higher than wide
      const high = this.box.clientHeight - (c.narrow ? top + LINE * lines : 0);
      const wide = this.box.clientWidth, fits = Math.min(2.35 / M.size(span), 1.95 / (0.92 * span[2] + 0.38 *
        Math.hypot(span[0], span[1]))) * Math.min(c.narrow ? 0.9 : 1, wide / (0.9 * high));
      return { ...out, scene: { xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: "manual",
        aspectratio: { x: span[0] * fits, y: span[1] * fits, z: span[2] * fits },
        camera: this.camera || camera("all") } };
    }

    listen() {
      const go = (n) => { this.slider.value = n; this.draw(); };
      this.slider.addEventListener("input", () => this.draw());
      this.find("back").addEventListener("click", () => go(+this.slider.value - 1));
      this.find("next").addEventListener("click", () => go(+this.slider.value + 1));
      this.find("home").addEventListener("click", () => go(this.home));
      this.root.querySelectorAll("[data-stage]").forEach((button) => button.addEventListener(
        "click", () => { this.stage = button.dataset.stage; this.draw(); }));
      const closer = this.find("closer");
      if (closer) closer.addEventListener("click", () => {
        this.closer = !this.closer;
        closer.setAttribute("aria-pressed", String(this.closer));
        this.draw();
      });
      this.root.querySelectorAll("[data-view]").forEach((button) => {
        button.hidden = this.scene.flat;
        button.addEventListener("click", () => {
          this.camera = camera(button.dataset.view);
          if (this.alive) Plotly.relayout(this.box, { "scene.camera": this.camera });
        });
      });
      document.addEventListener("ppmcal-select", (event) => {
        const keys = (event.detail && event.detail.keys) || [];
        if (keys.length || this.keys.length) this.choose(Array.from(keys));
      });
    }

    choose(keys) {
      const row = (this.scene.measured || []).find((m) => keys.includes(m.key));
      const before = this.keys.length;
      this.keys = row || !keys.length ? keys : keys.filter((k) => k.split(":")[0] === this.root.dataset.index);
      if (!before && !this.keys.length) return;
      if (row && row.frame !== undefined) this.slider.value = this.scene.order.indexOf(row.frame);
      this.draw();
    }

    clicked(event) {
      const key = event.points && event.points.map((p) => p.customdata).find((k) => k);
      // plotly is not to be drawn anew from within its own event
      if (key) setTimeout(() => document.dispatchEvent(new CustomEvent("ppmcal-select",
        { detail: { keys: [key], source: this.root } })), 0);
    }

    draw() {
      const n = this.scene.order[+this.slider.value], frame = this.first.frames[n];
      const c = M.context(this.scene, this.root), home = this.first.frames[0];
      this.root.dataset.frame = n;
      this.words(c, frame, n);
      this.box.style.backgroundColor = c.colour("card");
      if (!this.alive) return Promise.resolve();
      const stage = this.stage === "none" ? "after" : this.stage, at = [c, this.first, frame];
      const traces = [...M.effectTraces(...at), ...M.bodyTraces(...at, home), ...M.driveTraces(...at),
        ...M.machineTraces(...at, false), ...(this.second ? M.machineTraces(c, this.second,
          M.magnified(frame, this.second.frames[n], this.scene.magnification), true) : []),
        ...M.jointTraces(...at), ...M.axisTraces(c, frame), ...M.markTraces(...at),
        ...M.nextTraces(c, this.first.frames), ...M.pointTraces(c, stage, this.stage !== "none", new Set(this.keys))];
      const listed = traces.filter((t) => t.showlegend !== false).length;
      return Plotly.react(this.box, traces, this.layout(c, Math.ceil(listed / 2)), { responsive: true, displaylogo: false,
        modeBarButtons: [this.scene.flat
          ? ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]
          : ["toImage", "zoom3d", "pan3d", "orbitRotation", "tableRotation", "resetCameraDefault3d"]] })
        .then(() => { this.root.dataset.drawn = traces.length; });
    }

    start() {
      if (this.alive) return;
      this.alive = true;
      this.draw().then(() => {
        this.box.on("plotly_click", (event) => this.clicked(event));
        if (!this.scene.flat) this.box.on("plotly_relayout", (change) => {
          if (change["scene.camera"]) this.camera = change["scene.camera"];
        });
      });
    }

    stop() {
      this.alive = false;
      Plotly.purge(this.box);
      delete this.root.dataset.drawn;
    }

    words(c, frame, n) {
      const { scene } = this, find = this.find, second = this.second && this.second.frames[n];
      const home = this.first.frames[0], signed = (v) => (v > 0 ? "+" : "") + c.num(v);
      const change = (a, b) => (Math.abs(a - b) < 1e-9 * Math.max(1, Math.abs(b)) ? "0" : signed(a - b));
      find("label").value = frame.label;
      this.slider.setAttribute("aria-valuetext", frame.label);
      this.root.querySelectorAll("[data-stage]").forEach((b) =>
        b.setAttribute("aria-pressed", String(b.dataset.stage === this.stage)));
      const heads = second ? [this.first.name, this.second.name] : ["value", "from home"];
      const rows = (names, own, other, start, units) => names.map((name, i) => [name, c.num(own[i]),
        second ? c.num(other[i]) : change(own[i], start[i]), units[i]]);
      M.table(find("coordinates"), "Platform", ["pose", ...heads, "unit"], rows(scene.coordinates,
        frame.pose, second && second.pose, home.pose, scene.coordinate_units));
      M.table(find("joints"), "Joint values", ["joint", "q", "from home", "unit"], scene.actuators.map(
        (a, i) => [a, c.num(frame.q[i]), change(frame.q[i], home.q[i]), scene.joint_units[i]]));
      M.lines(find("marks"), M.marks(frame).map((m) => m.text));
      M.lines(find("row-said"), M.chosenWords(c, this.keys, this.first.frames));
      this.root.dataset.chosen = this.keys.length;
      this.root.dataset.limbs = frame.limbs.length;
    }
  }

  M.lines = (place, lines) => {
    place.hidden = !lines.length;
    place.replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"),
      { textContent: line })));
  };

  M.table = (place, caption, heads, rows) => {
    const line = (texts, head) => {
      const row = document.createElement("tr");
      row.append(...texts.map((text, i) => Object.assign(document.createElement(
        head || !i ? "th" : "td"), { textContent: text, className: i ? "n" : "" })));
      return row;
    };
    const title = Object.assign(document.createElement("caption"), { textContent: caption });
    const head = document.createElement("thead"), body = document.createElement("tbody");
    head.append(line(heads, true));
    body.append(...rows.map((r) => line(r, false)));
    place.replaceChildren(title, head, body);
  };

  const all = Array.from(document.querySelectorAll(".machine")).map((root) => new View(root));
  const alive = () => all.filter((v) => v.alive);
  const near = new IntersectionObserver((entries) => entries.forEach((entry) => {
    const view = all.find((v) => v.root === entry.target);
    view.near = entry.isIntersecting;
    if (!view.near) return;
    view.start();
    const far = alive().filter((v) => !v.near && !v.scene.flat);
    if (alive().length > MOST_ALIVE && far.length) far[0].stop();
  }), { rootMargin: "400px" });
  all.forEach((view) => { view.words(M.context(view.scene, view.root), view.first.frames[
    view.scene.order[+view.slider.value]], view.scene.order[+view.slider.value]); near.observe(view.root); });

  // a chapter that folds beside it changes its width, and so does the list of contents
  const sizes = new ResizeObserver((entries) => entries.forEach((entry) => {
    const view = all.find((v) => v.box === entry.target), width = entry.contentRect.width;
    if (view.alive && view.root.dataset.drawn && view.width && Math.abs(view.width - width) > 1)
      Plotly.Plots.resize(view.box);
    view.width = width;
  }));
  all.forEach((view) => sizes.observe(view.box));

  // another theme, or paper, has other colours
  const again = () => alive().forEach((view) => view.draw());
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  new MutationObserver(again).observe(document.documentElement, { attributes: true });
  const paper = (on) => () => all.forEach((view) => {
    // a drawing in 3D comes a moment later than paper waits: a dark one is printed as its negative
    const ground = view.box.style.backgroundColor.match(/[\d.]+/g) || [255, 255, 255];
    const dark = ground.slice(0, 3).map(Number).reduce((s, v) => s + v, 0) < 384;
    if (view.scene.flat) view.root.classList.toggle("m-paper", on);
    else view.root.classList.toggle("m-negative", on && dark);
    if (on) view.start();
    if (view.scene.flat) view.draw();
  });
  window.addEventListener("beforeprint", paper(true));
  window.addEventListener("afterprint", paper(false));
})(window.PpmcalMachine = window.PpmcalMachine || {});
