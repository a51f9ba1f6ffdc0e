"use strict";
// Draws every figure.plot from the JSON in it, when it comes near the window; links their rows.
(() => {
  const NEAR = "400px", PAPER = 330;
  const coarse = window.matchMedia("(pointer: coarse)").matches;
  const root = document.documentElement;
  let chosen = new Set(), paper = false, known = null, palette = new Map();

  // what is known of each row, by its key
  function about(key) {
    if (!known) {
      known = {};
      document.querySelectorAll("script.rows").forEach((s) => Object.assign(known, JSON.parse(s.textContent)));
    }
    return Object.hasOwn(known, key) ? known[key] : "";
  }

  // --- colours: "--after/0.5" is the page's --after, half transparent ----------------------------
  const probe = document.createElement("span");
  probe.hidden = true;
  document.body.append(probe);
  function onPaper(name) {
    // the style by day, and what it says of paper; the media in force may be another one
    let found = "";
    for (const sheet of document.styleSheets)
      for (const rule of sheet.cssRules) {
        const inner = rule.media ? (rule.media.mediaText === "print" ? [...rule.cssRules] : []) : [rule];
        for (const r of inner)
          if (r.selectorText === ":root") found = r.style.getPropertyValue(name).trim() || found;
      }
    return found;
  }
  function colour(text) {
    const [name, ...alphas] = text.split("/");
    if (!palette.has(name)) {
      probe.style.color = "";
      probe.style.color = (paper && onPaper(name)) || `var(${name})`;
      palette.set(name, (getComputedStyle(probe).color.match(/[\d.]+/g) || [0, 0, 0]).map(Number));
    }
    const [r, g, b, a = 1] = palette.get(name);
    return `rgba(${r},${g},${b},${alphas.reduce((v, x) => v * x, a)})`;
  }
  function painted(value, key) {
    if (typeof value === "string") return /color$/.test(key) && value.startsWith("--") ? colour(value) : value;
    if (Array.isArray(value)) return typeof value[0] === "object" ? value.map((v) => painted(v, key)) : value;
    if (!value || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, painted(v, k)]));
  }

  // --- words cut to the room there is, and shown by plotly as they are --------------------------
  const pen = document.createElement("canvas").getContext("2d");
  const safe = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const wide = (text) => pen.measureText(text).width;
  function fitted(text, room) {
    if (wide(text) <= room) return text;
    const letters = [...text];
    while (letters.length > 3 && wide(letters.join("") + "\u2026") > room) letters.pop();
    return letters.join("").trimEnd() + "\u2026";
  }

  // labels of rows of bars and the words at their ends, and where the bars are between them
  function rowWords(spec, full, font) {
    const edge = 0.02 * full, face = (bold) => { pen.font = `${bold ? "bold " : ""}${font.size}px ${font.family}`; };
    const size = (text, bold) => { face(bold); return wide(text); };
    const most = (rows, key, bold) => Math.max(0, ...rows.map((r) => size(r[key], r[bold])));
    const bars = spec.rows.filter((r) => r.bars);
    const left = edge + Math.min(most(bars, "label", "bold"), 0.3 * full) + 6;
    const right = full - edge - Math.min(most(spec.rows, "words", "strong"), 0.45 * full) - 10;
    const annotations = spec.rows.flatMap((r) => {
      const end = Math.min(size(r.words, r.strong), 0.45 * full);
      const room = spec.beside && r.bars ? left - edge - 4 : full - 2 * edge - end - 8;
      return [[r.label, edge, "left", r.bold, room], [r.words, full - edge, "right", r.strong, end + 1]]
        .filter(([words]) => words).map(([words, x, side, bold, most_]) => {
          face(bold);
          const shown = safe(fitted(words, most_));
          return { xref: "paper", x: x / full, y: r.y, xanchor: side, yanchor: "middle", showarrow: false,
            borderpad: 0, text: bold ? `<b>${shown}</b>` : shown, hovertext: shown === safe(words) ? "" : safe(words) };
        });
    });
    return { annotations, domain: spec.beside ? [left / full, Math.max(right / full, left / full + 0.1)] : null };
  }

  // where a row stands that is drawn only when it is chosen; null where it has no place
  function placed(rest, key) {
    const cut = key.lastIndexOf(":"), owner = key.slice(0, cut), row = +key.slice(cut + 1);
    let before = 0;
    for (const [name, first, count] of rest.runs) {
      const i = before + row - first;
      if (name === owner && row >= first && row < first + count && rest.y[i] !== null)
        return { x: rest.x ? rest.x[i] : i + 1, y: rest.y[i] };
      before += count;
    }
    return null;
  }
  const called = (key) => `${key.slice(key.indexOf(":") + 1, key.lastIndexOf(":"))}, row ${key.slice(key.lastIndexOf(":") + 1)}`;
  const owner = (key) => key.slice(0, key.lastIndexOf(":"));

  // --- one figure --------------------------------------------------------------------------------
  class Figure {
    constructor(element) {
      this.element = element;
      this.box = element.querySelector(".drawing");
      this.spec = null;
      this.note = Object.assign(document.createElement("p"), { className: "undrawn", hidden: true });
      this.box.after(this.note);
      this.near = this.stale = false;
    }
    get drawn() { return this.spec !== null; }
    get linked() { return this.spec.data.some((t) => t.customdata); }

    traces() {
      const ring = { x: [], y: [] }, late = [];
      const shown = new Set(this.spec.data.flatMap((t) => (t.customdata || []).filter((k) => chosen.has(k))));
      for (const trace of this.spec.data)
        if (trace.undrawn) for (const key of chosen) {
          const at = trace.customdata.includes(key) ? null : placed(trace.undrawn, key);
          if (!at) continue;
          shown.add(key);
          ring.x.push(at.x);
          ring.y.push(at.y);
          late.push({ type: "scatter", mode: "markers", x: [at.x], y: [at.y], customdata: [key], cliponaxis: false,
            text: [about(key) || safe(called(key))], name: trace.name, showlegend: false,
            hovertemplate: typeof trace.hovertemplate === "string" ? trace.hovertemplate : "%{text}<extra></extra>",
            marker: { ...painted(trace.marker, "") } });
        }
      this.say(shown);
      const own = shown.size > 0;
      const out = this.spec.data.map(({ undrawn, ...trace }) => {
        const made = { showlegend: false, ...painted(trace, "") };
        if (!trace.customdata) return made;
        made.text = trace.customdata.map(about);
        made.selectedpoints = null;
        if (own) {
          made.selectedpoints = trace.customdata.flatMap((k, i) => (chosen.has(k) ? [i] : []));
          made.selectedpoints.forEach((i) => { ring.x.push(trace.x[i]); ring.y.push(trace.y[i]); });
        }
        made.selected = { marker: { opacity: 1 } };
        made.unselected = { marker: { opacity: 0.25 } };
        return made;
      });
      out.push(...late);
      out.push({ type: "scatter", mode: "markers", ...ring, hoverinfo: "skip", showlegend: false,
        cliponaxis: false, name: "selected", marker: { symbol: "circle-open", size: 13,
          color: colour("--ink"), line: { width: 2 } } });
      this.lit = ring.x.length;
      return out;
    }

    // of chosen rows that have no point here, how many rows have one
    say(shown) {
      const drawn = new Set(this.spec.data.flatMap((t) => t.customdata || []));
      const owners = new Set([...drawn].map(owner));
      const gone = [...chosen].filter((k) => !shown.has(k) && owners.has(owner(k)));
      this.note.hidden = !gone.length;
      const which = gone.slice(0, 3).map(called).join("; ") + (gone.length > 3 ? `; and ${gone.length - 3} more` : "");
      this.note.textContent = gone.length ? `Not drawn here: ${which}. ${drawn.size} rows are.` : "";
    }

    layout() {
      const small = this.box.clientWidth < 430 || paper;
      const font = { color: colour("--ink"), size: small ? 11 : 12, family: getComputedStyle(this.box).fontFamily };
      const given = painted(this.spec.layout, "");
      if (this.spec.rows) {
        const { annotations, domain } = rowWords(this.spec, paper ? PAPER : this.box.clientWidth, font);
        Object.assign(given, { annotations });
        if (domain) given.xaxis.domain = domain;
        // the legend may need one line more
        if (small && given.showlegend) given.margin.t += 16;
      }
      const axis = (more) => ({ automargin: true, zeroline: false, gridcolor: colour("--line"),
        linecolor: colour("--soft"), tickcolor: colour("--soft"), tickfont: { color: colour("--soft") },
        showline: true, autorange: false, ...more,
        title: { standoff: 8, font: { size: small ? 11 : 12 }, ...(more || {}).title } });
      const size = paper ? { autosize: false, width: PAPER } : { autosize: true, width: undefined };
      return { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", uirevision: "kept",
        margin: { l: 4, r: 12, t: 26, b: 4 }, hovermode: "closest", hoverdistance: 14, barmode: "overlay",
        dragmode: coarse ? false : this.mode || "zoom", selections: [], ...given, ...size,
        height: this.spec.height, xaxis: axis(given.xaxis), yaxis: axis(given.yaxis),
        font,
        legend: { orientation: "h", x: 0, xanchor: "left", y: 1, yanchor: "bottom", itemsizing: "trace",
          font: { color: colour("--soft"), size: small ? 10.5 : 12 }, bgcolor: "rgba(0,0,0,0)", traceorder: "normal" },
        hoverlabel: { bgcolor: colour("--card"), bordercolor: colour("--soft"), align: "left",
          font: { color: colour("--ink"), size: 12 }, namelength: -1 },
        newselection: { line: { color: colour("--ink"), width: 1 } },
        modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--soft"), activecolor: colour("--ink") } };
    }

    config() {
      const pick = this.linked ? ["select2d", "lasso2d"] : [];
      return { displaylogo: false, responsive: true, doubleClick: "reset", showTips: false,
        modeBarButtons: [["zoom2d", "pan2d", ...pick, "resetScale2d", "toImage"]], displayModeBar: coarse ? false : "hover",
        toImageButtonOptions: { format: "svg", filename: this.box.dataset.name } };
    }

    draw() {
      const first = !this.drawn;
      if (first) this.spec = JSON.parse(this.element.querySelector("script").textContent);
      this.stale = false;
      this.busy = true;
      const done = Plotly.react(this.box, this.traces(), this.layout(), this.config())
        .then(() => {
          this.busy = false;
          this.box.dataset.lit = this.lit;
          this.box.dataset.drawn = this.spec.data.length;
        });
      if (first) this.listen();
      return done;
    }

    listen() {
      const { box } = this;
      const keys = (event) => [...new Set(event.points.map((p) => p.customdata).filter(Boolean))];
      box.on("plotly_click", (event) => {
        const [key] = keys(event);
        if (!key) return;
        const adding = event.event && (event.event.shiftKey || event.event.ctrlKey || event.event.metaKey);
        const now = new Set(adding ? chosen : []);
        if (adding && chosen.has(key)) now.delete(key); else now.add(key);
        select([...now], box);
      });
      box.on("plotly_selected", (event) => {
        if (event && !this.busy && this.linked) select(keys(event), box);
      });
      box.on("plotly_deselect", () => { if (!this.busy && chosen.size) select([], box); });
      // another tool is kept when the plot is drawn anew
      box.on("plotly_relayout", (change) => { if (change.dragmode) this.mode = change.dragmode; });
      box.addEventListener("keydown", (event) => this.step(event));
    }

    // arrow keys go from point to point, Enter selects it
    step(event) {
      const moves = { ArrowRight: 1, ArrowLeft: -1 };
      const index = this.spec.data.findLastIndex((t) => t.hovertemplate || t.hovertext);
      if (index < 0 || event.target !== this.box) return;
      const trace = this.spec.data[index], n = trace.x.length;
      if (event.key in moves && n) {
        this.at = ((this.at === undefined ? (moves[event.key] > 0 ? -1 : 0) : this.at) + moves[event.key] + n) % n;
        Plotly.Fx.hover(this.box, [{ curveNumber: index, pointNumber: this.at }]);
        const label = this.box.querySelector(".hoverlayer .hovertext");
        if (label) this.box.setAttribute("aria-description", [...label.querySelectorAll("tspan, text")]
          .filter((t) => !t.querySelector("tspan")).map((t) => t.textContent).join(", "));
      } else if (event.key === "Enter" && this.at !== undefined && trace.customdata) {
        select([trace.customdata[this.at]], this.box);
      } else return;
      event.preventDefault();
    }
  }

  const figures = [...document.querySelectorAll("figure.plot")].map((e) => new Figure(e));
  const of = new Map(figures.map((f) => [f.box, f]));
  const again = (all) => figures.forEach((f) => {
    if (!f.drawn) return;
    if (all || f.near) f.draw(); else f.stale = true;
  });

  // --- when it is seen -----------------------------------------------------------------------------
  const near = new IntersectionObserver((entries) => entries.forEach((entry) => {
    const figure = of.get(entry.target);
    figure.near = entry.isIntersecting;
    if (figure.near && (!figure.drawn || figure.stale)) figure.draw();
  }), { rootMargin: NEAR });
  const sized = new ResizeObserver((entries) => entries.forEach(({ target }) => {
    const figure = of.get(target), full = target._fullLayout;
    if (figure.drawn && full && target.clientWidth && !paper && Math.abs(full.width - target.clientWidth) > 1)
      figure.draw();
  }));
  figures.forEach((f) => { near.observe(f.box); sized.observe(f.box); });

  const recolour = () => { palette = new Map(); again(false); };
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
  // not its style: plotly puts the mouse's look there
  new MutationObserver(recolour).observe(root, { attributes: true, attributeFilter: ["class", "data-theme"] });
  window.addEventListener("beforeprint", () => {
    paper = true;
    palette = new Map();
    figures.forEach((f) => f.draw());
  });
  window.addEventListener("afterprint", () => {
    paper = false;
    recolour();
  });

  // --- rows that are chosen, here or by a table or the machine ----------------------------------------
  function select(keys, source) {
    document.dispatchEvent(new CustomEvent("ppmcal-select", { detail: { keys, source } }));
  }
  document.addEventListener("ppmcal-select", (event) => {
    chosen = new Set((event.detail && event.detail.keys) || []);
    again(false);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && chosen.size) select([], document);
  });
})();
