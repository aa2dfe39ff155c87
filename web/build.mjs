// Bundles src/ and deck.gl into the page's script, with the licences of all that is in it. With --check nothing is
// written: it fails where a build gives other bytes than those that are committed.
import { build } from "esbuild";
import { existsSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const assets = join(here, "..", "src", "skyrelay", "report", "assets");

const result = await build({
  absWorkingDir: here,
  entryPoints: ["src/main.js"],
  bundle: true,
  minify: true,
  format: "iife",
  target: ["chrome100", "firefox113", "safari16.4"],
  define: { "process.env.NODE_ENV": '"production"' },
  charset: "utf8",
  legalComments: "none", // the licences lie beside the bundle, whole
  metafile: true,
  write: false,
});

const packages = new Set();
for (const input of Object.keys(result.metafile.inputs)) {
  const match = /^node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(input);
  if (match) packages.add(match[1]);
}
const notices = [...packages].sort().map((name) => {
  const folder = join(here, "node_modules", name);
  const { version, license } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const file = readdirSync(folder).sort().find((entry) => /^(licen[cs]e|copying)/i.test(entry));
  const text = file ? readFileSync(join(folder, file), "utf8").trim() : `Licensed under ${license}.`;
  return `${name} ${version} (${license})\n\n${text}\n`;
});
const outputs = {
  // As a bundle stands inside a page, a comment or a closing tag in it must not be read as HTML.
  "page.js": result.outputFiles[0].text.replaceAll("<!--", "\\x3c!--").replaceAll(/<(?=\/?script)/gi, "\\x3c"),
  "page.js.licences.txt": `The script page.js contains:\n\n${notices.join("\n" + "-".repeat(80) + "\n\n")}`,
};

let stale = false;
for (const [name, text] of Object.entries(outputs)) {
  const path = join(assets, name);
  if (!process.argv.includes("--check")) writeFileSync(path, text);
  else if (!existsSync(path) || readFileSync(path, "utf8") !== text) {
    console.error(`${name} is not what web/src gives: run npm run build in web/`);
    stale = true;
  }
}
process.exit(stale ? 1 : 0);
