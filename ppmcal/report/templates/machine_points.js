"use strict";
// measured rows as points on the machine, their errors, and the row that is chosen
((M) => {
  const { safe, size } = M;
  const scale = [[0, "#4f86d9"], [0.5, "#e8a33d"], [1, "#cf2f3f"]];

  // what is shown of a row at one stage of the fit
  M.atStage = (m, stage) => (stage === "before" ? { value: m.value_before, error: m.error_before,
    turn: m.turn_before } : { value: m.value, error: m.error, turn: m.turn });

  M.said = (c, m) => {
    const S = c.scene, line = (what, a, b, unit) => (a === undefined && b === undefined ? ""
      : `${what}: ${M.digits(a)} ${unit} after the fit` + (b === undefined ? ""
      : `, ${M.digits(b)} ${unit} before`));
    return [line(S.value || "value", m.value, m.value_before, S.value_unit),
      line("rotation", m.turn, m.turn_before, S.turn_unit),
      m.used === false ? `left out of the fit${m.reason ? ": " + m.reason : ""}` : ""].filter((t) => t);
  };

  M.pointTraces = (c, stage, arrows, chosen) => {
    const S = c.scene, shown = S.measured || [];
    if (!shown.length) return [];
    const hover = shown.map((m) => [`<b>${safe(m.label)}</b>`, ...M.said(c, m).map(safe)].join("<br>"));
    const valued = shown.some((m) => m.used !== false && M.atStage(m, stage).value !== undefined);
    const values = shown.filter((m) => m.used !== false).map((m) => M.atStage(m, stage).value || 0);
    const bar = { orientation: "h", thickness: 10, len: c.narrow ? 0.9 : 0.6, x: 0.5, y: 1.01,
      yanchor: "bottom", tickfont: { color: c.colour("soft"), size: 11 }, nticks: 5,
      title: { text: safe(`${S.value} ${stage} the fit [${S.value_unit}]`), side: "top",
        font: { color: c.colour("soft"), size: 12 } }, outlinewidth: 0 };
    const colours = [];
    const points = c.pieces("measured rows", { mode: "markers", marker: {
      size: c.flat ? 9 : 4.5, color: valued ? colours : c.colour("z"),
      line: { color: c.colour("card"), width: c.flat ? 1 : 0 },
      ...(valued && { colorscale: scale, cmin: 0, cmax: Math.max(...values) || 1, colorbar: bar }) } });
    const out = c.pieces("left out of the fit", { mode: "markers", marker: {
      symbol: c.flat ? "x" : "square-open", size: c.flat ? 10 : 6, color: c.colour("out"),
      line: { color: c.colour("out"), width: 1 } } });
    const low = [0, 1, 2].map((k) => Math.min(...shown.map((m) => m.point[k])));
    const room = Math.max(...low.map((v, k) => Math.max(...shown.map((m) => m.point[k])) - v));
    const longest = Math.min(0.2 * c.reach, 0.25 * room || c.reach);
    const factor = stage === "before" ? S.error_magnification_before : S.error_magnification;
    const errors = c.pieces(`errors ${stage} the fit, \u00d7 ${M.digits(factor)}`,
      c.line(c.colour("soft"), 1.3));
    shown.forEach((m, i) => {
      const { value, error } = M.atStage(m, stage);
      if (m.used === false) out.add([m.point], hover[i], m.key);
      else {
        points.add([m.point], hover[i], m.key);
        colours.push(value === undefined ? 0 : value, 0);
      }
      // what was left out may be a thousand times as far off: its arrow would cover all others
      if (arrows && error && size(error) > 0 && factor * size(error) < longest)
        M.arrow(c, errors, m.point, error, hover[i], factor * size(error), m.key);
    });
    const lit = c.pieces("chosen", { mode: "markers", marker: { symbol: "circle-open",
      size: c.flat ? 20 : 11, color: c.colour("pick"), line: { color: c.colour("pick"), width: 3 } } });
    shown.forEach((m, i) => chosen.has(m.key) && lit.add([m.point], hover[i], m.key));
    return [errors, points, out, lit].filter((p) => p.points.length).map((p) => p.trace());
  };

  // where the platform is to stand for what should be measured next
  M.nextTraces = (c, frames) => {
    const wanted = c.pieces("measure next", { mode: "markers", marker: { symbol: "diamond",
      size: c.flat ? 11 : 6, color: c.colour("pick"), line: { color: c.colour("card"), width: 1 } } });
    frames.forEach((f) => (f.key || "").startsWith("next:") && wanted.add([f.origin], safe(f.label), f.key));
    return wanted.points.length ? [wanted.trace()] : [];
  };

  // all keys chosen: a list of rows in words, with the numbers of the first
  M.chosenWords = (c, keys, frames) => {
    if (!keys.length) return [];
    const rows = (c.scene.measured || []).filter((m) => keys.includes(m.key));
    if (!rows.length) return ["The chosen row is not among the points drawn here."];
    const [m] = rows, where = m.frame === undefined ? "" : m.own ? "The machine stands at its joint values."
      : `The machine stands at the nearest drawn pose, ${frames[m.frame].label}.`;
    const more = rows.length > 1 ? `${rows.length} rows are chosen; this is the first.` : "";
    return [m.label, ...M.said(c, m), where, more].filter((t) => t);
  };
})(window.PpmcalMachine = window.PpmcalMachine || {});
