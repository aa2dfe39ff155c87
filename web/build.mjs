// Bundles src/ into the page's script. With --check nothing is written: it fails where a build gives other bytes than
// those that are committed.
import { build } from "esbuild";
import { existsSync, readFileSync, writeFileSync } from "node:fs";
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
  charset: "utf8",
  write: false,
});

const outputs = {
  // As a bundle stands inside a page, a comment or a closing tag in it must not be read as HTML.
  "page.js": result.outputFiles[0].text.replaceAll("<!--", "\\x3c!--").replaceAll(/<(?=\/?script)/gi, "\\x3c"),
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
