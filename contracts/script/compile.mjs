// Compile the contracts with the pinned compiler and write the artifacts that the Python package carries.
//
//   node script/compile.mjs           write src/skyrelay/chain/artifacts/*.json
//   node script/compile.mjs --check   exit 1, naming the first difference, if a committed one is not what the sources give
//
// SkyRelay's ABI is the union of both contracts', for both answer at its address.
import { createHash } from "node:crypto";
import { existsSync, readFileSync, readdirSync, renameSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, relative, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const root = resolve(dirname(fileURLToPath(import.meta.url)), "..");
const folder = resolve(root, "../src/skyrelay/chain/artifacts");
const require = createRequire(import.meta.url);

function fail(message) {
  console.error(message);
  process.exit(1);
}

if (!existsSync(join(root, "node_modules", "solc"))) fail("contracts/node_modules: not there; run `npm ci` in contracts/");
const solc = require("solc");

function sourcesUnder(folder) {
  return readdirSync(folder, { withFileTypes: true })
    .flatMap((entry) => (entry.isDirectory() ? sourcesUnder(join(folder, entry.name)) : [join(folder, entry.name)]))
    .filter((path) => path.endsWith(".sol"))
    .sort();
}

const settings = JSON.parse(readFileSync(join(root, "settings.json"), "utf8"));
const sources = {};
for (const path of sourcesUnder(join(root, "src"))) {
  sources[relative(root, path)] = { content: readFileSync(path, "utf8") };
}
const used = { ...sources };
const outputs = [
  "abi",
  "storageLayout",
  "evm.bytecode.object",
  "evm.deployedBytecode.object",
  "evm.deployedBytecode.immutableReferences",
  "evm.methodIdentifiers",
];
const output = JSON.parse(
  solc.compile(
    JSON.stringify({ language: "Solidity", sources, settings: { ...settings, outputSelection: { "*": { "*": outputs } } } }),
    {
      import: (path) => {
        const file = join(root, "node_modules", path);
        if (!existsSync(file)) return { error: `${path} is not in node_modules` };
        used[path] = { content: readFileSync(file, "utf8") };
        return { contents: used[path].content };
      },
    },
  ),
);
const problems = output.errors ?? [];
if (problems.length) fail(problems.map((problem) => problem.formattedMessage).join("\n"));

const hash = createHash("sha256");
for (const path of Object.keys(used).sort()) hash.update(`${path}\0${used[path].content}\0`);
const sourceHash = `0x${hash.digest("hex")}`;

/** Type names without the compiler's internal numbers, which change with unrelated edits. */
function plain(value) {
  if (typeof value === "string") return value.replace(/\)\d+_storage/g, ")_storage").replace(/\)\d+(?=[,)_]|$)/g, ")");
  if (Array.isArray(value)) return value.map(plain);
  if (typeof value !== "object" || value === null) return value;
  const kept = Object.entries(value).filter(([key]) => key !== "astId" && key !== "contract");
  return Object.fromEntries(kept.map(([key, inner]) => [plain(key), plain(inner)]));
}

function union(first, second) {
  const known = new Set(first.map((entry) => JSON.stringify(entry)));
  return [...first, ...second.filter((entry) => entry.type !== "constructor" && !known.has(JSON.stringify(entry)))];
}

function artifact(name, extra, folder = "") {
  const contract = output.contracts[`src/${folder}${name}.sol`][name];
  return {
    contractName: name,
    compiler: { name: "solc", version: solc.version().replace(/\.Emscripten.*/, ""), settings },
    sourceHash,
    abi: extra ? union(contract.abi, extra.abi) : contract.abi,
    methodIdentifiers: { ...contract.evm.methodIdentifiers, ...extra?.methodIdentifiers },
    bytecode: `0x${contract.evm.bytecode.object}`,
    deployedBytecode: `0x${contract.evm.deployedBytecode.object}`,
    // The keys are the compiler's numbers: the places are listed one after the other instead.
    immutableReferences: { all: Object.values(contract.evm.deployedBytecode.immutableReferences ?? {}).flat() },
    storageLayout: plain(contract.storageLayout),
  };
}

const extension = artifact("SkyRelayExtension");
const payment = ["SkyRelayPayments", "Credit"].map((name) => artifact(name, null, "payment/"));
for (const result of [artifact("SkyRelay", extension), extension, artifact("OptimisticSelection"), ...payment]) {
  const path = join(folder, `${result.contractName}.json`);
  const shown = relative(resolve(root, ".."), path);
  const size = `${result.deployedBytecode.length / 2 - 1} bytes of code`;
  const text = `${JSON.stringify(result, null, 1)}\n`;
  if (process.argv.includes("--check")) {
    const committed = existsSync(path) ? readFileSync(path, "utf8") : "";
    if (committed !== text) {
      const lines = text.split("\n");
      const old = committed.split("\n");
      const at = lines.findIndex((line, index) => line !== old[index]);
      fail(
        `${shown}, line ${at + 1}: is ${JSON.stringify((old[at] ?? "").slice(0, 100))}; ` +
          `the sources give ${JSON.stringify((lines[at] ?? "").slice(0, 100))}. Run \`npm run build\` in contracts/ and commit the result`,
      );
    }
    console.log(`${shown} agrees with the sources (${size})`);
  } else {
    writeFileSync(`${path}.new`, text);
    renameSync(`${path}.new`, path);
    console.log(`wrote ${shown} (${size})`);
  }
}
