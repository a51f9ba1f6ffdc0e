// Makes plotly.min.js and its licences; see README.md.
import fs from "node:fs";
import path from "node:path";
import esbuild from "esbuild";
import { environmentPlugin } from "esbuild-plugin-environment";
import { glsl } from "esbuild-plugin-glsl";
import inlineCSS from "esbuild-plugin-inline-css";

const TRACES = ["bar", "scatter3d", "mesh3d"]; // scatter is in the core
const entry = `const Plotly = require("plotly.js/lib/core");
Plotly.register([${TRACES.map((t) => `require("plotly.js/lib/${t}")`)}]);
module.exports = Plotly;`;

// descriptions of attributes are for plotly's own reference, and the map's style is for no trace here
const text = "(?:'(?:[^'\\\\\\n]|\\\\.)*'|\"(?:[^\"\\\\\\n]|\\\\.)*\"|`(?:[^`\\\\$]|\\\\.)*`)";
const described = new RegExp("\\bdescription:\\s*(?:\\[(?:\\s|,|\\+|//.*\\n|" + text +
  ")*\\]\\s*\\.join\\(" + text + "\\)|" + text + "(?:\\s*\\+\\s*" + text + ")*)(?=\\s*[,}\\n])", "g");
const lean = {
  name: "lean",
  setup(build) {
    build.onResolve({ filter: /maplibre-gl\.css$/ }, () => ({ path: "none", namespace: "none" }));
    build.onLoad({ filter: /.*/, namespace: "none" }, () => ({ contents: "" }));
    build.onLoad({ filter: /plotly\.js\/src\/.*\.js$/ }, ({ path: file }) => ({
      contents: fs.readFileSync(file, "utf8").replace(described, "description: ''"),
      loader: "js",
    }));
  },
};

const version = JSON.parse(fs.readFileSync("node_modules/plotly.js/package.json", "utf8")).version;
const { metafile } = await esbuild.build({
  stdin: { contents: entry, resolveDir: "." }, outfile: "plotly.min.js", metafile: true,
  bundle: true, minify: true, format: "iife", globalName: "Plotly", charset: "ascii",
  target: "es2016", logLevel: "warning", legalComments: "none",
  banner: { js: `/* plotly.js ${version} (scatter, ${TRACES.join(", ")}), Copyright 2012-2026 ` +
    "Plotly, Inc. Licensed under the MIT license */" },
  plugins: [lean, inlineCSS(), glsl({ minify: true }), environmentPlugin({ NODE_DEBUG: false })],
  alias: { regl: "@plotly/regl", stream: "stream-browserify" },
  define: { global: "window", "define.amd": "false" },
});

const parts = new Set(Object.entries(metafile.outputs["plotly.min.js"].inputs)
  .filter(([, v]) => v.bytesInOutput).map(([file]) =>
    (/^(.*node_modules\/(?:@[^/]+\/)?[^/]+)\//.exec(file.replace(/^[^:]*:/, "")) || [])[1])
  .filter(Boolean));
const licences = [...parts].sort().map((folder) => {
  const about = JSON.parse(fs.readFileSync(path.join(folder, "package.json"), "utf8"));
  const file = fs.readdirSync(folder).find((f) => /^licen[cs]e/i.test(f));
  return `${about.name} ${about.version}, ${about.license}\n\n` +
    (file ? fs.readFileSync(path.join(folder, file), "utf8").trim() : "(no licence text)") + "\n";
});
fs.writeFileSync("plotly.LICENSES", licences.join(`\n${"-".repeat(80)}\n\n`));
