// Compile the contract with the pinned compiler and write the artifact that the Python package carries.
//
//   node script/compile.mjs           write src/skyrelay/chain/artifacts/SkyRelay.json
//   node script/compile.mjs --check   exit 1, naming the first difference, if the committed artifact is not what the sources give
//
// The settings are read from settings.json, which foundry.toml repeats (a test compares them).
import { createHash } from "node:crypto";
import { existsSync, readFileSync, readdirSync, renameSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, relative, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const root = resolve(dirname(fileURLToPath(import.meta.url)), "..");
const artifactPath = resolve(root, "../src/skyrelay/chain/artifacts/SkyRelay.json");
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
const input = {
  language: "Solidity",
  sources,
  settings: {
    ...settings,
    outputSelection: {
      "src/SkyRelay.sol": {
        SkyRelay: [
          "abi",
          "storageLayout",
          "evm.bytecode.object",
          "evm.deployedBytecode.object",
          "evm.deployedBytecode.immutableReferences",
          "evm.methodIdentifiers",
        ],
      },
    },
  },
};
const output = JSON.parse(
  solc.compile(JSON.stringify(input), {
    import: (path) => {
      const file = join(root, "node_modules", path);
      if (!existsSync(file)) return { error: `${path} is not in node_modules` };
      used[path] = { content: readFileSync(file, "utf8") };
      return { contents: used[path].content };
    },
  }),
);
const problems = output.errors ?? [];
if (problems.length) fail(problems.map((problem) => problem.formattedMessage).join("\n"));

const contract = output.contracts["src/SkyRelay.sol"].SkyRelay;
const hash = createHash("sha256");
for (const path of Object.keys(used).sort()) {
  hash.update(`${path}\0${used[path].content}\0`);
}
const artifact = {
  contractName: "SkyRelay",
  compiler: { name: "solc", version: solc.version().replace(/\.Emscripten.*/, ""), settings },
  sourceHash: `0x${hash.digest("hex")}`,
  abi: contract.abi,
  methodIdentifiers: contract.evm.methodIdentifiers,
  bytecode: `0x${contract.evm.bytecode.object}`,
  deployedBytecode: `0x${contract.evm.deployedBytecode.object}`,
  immutableReferences: contract.evm.deployedBytecode.immutableReferences,
  storageLayout: {
    // Compiler-internal numbers (astId, and those inside type names) change with unrelated edits: left out.
    storage: contract.storageLayout.storage.map(({ label, slot, offset, type }) => ({ label, slot, offset, type: plain(type) })),
    types: Object.fromEntries(
      Object.entries(contract.storageLayout.types).map(([name, type]) => [
        plain(name),
        {
          ...Object.fromEntries(Object.entries(type).map(([key, value]) => [key, typeof value === "string" ? plain(value) : value])),
          ...(type.members && {
            members: type.members.map(({ label, slot, offset, type: member }) => ({ label, slot, offset, type: plain(member) })),
          }),
        },
      ]),
    ),
  },
};

function plain(name) {
  return name.replace(/\)\d+_storage/g, ")_storage").replace(/\)(\d+)(?=[,)]|$)/g, ")");
}

// One key a line at the top two levels: differences can be read, and the bytecode stays one line.
const text = `${JSON.stringify(artifact, null, 1)}\n`;
if (process.argv.includes("--check")) {
  const committed = existsSync(artifactPath) ? readFileSync(artifactPath, "utf8") : "";
  if (committed !== text) {
    const lines = text.split("\n");
    const old = committed.split("\n");
    const at = lines.findIndex((line, index) => line !== old[index]);
    fail(
      `${relative(resolve(root, ".."), artifactPath)}, line ${at + 1}: is ${JSON.stringify((old[at] ?? "").slice(0, 100))}; ` +
        `the sources give ${JSON.stringify((lines[at] ?? "").slice(0, 100))}. Run \`npm run build\` in contracts/ and commit the result`,
    );
  }
  console.log(`artifact agrees with the sources (${artifact.deployedBytecode.length / 2 - 1} bytes of code)`);
} else {
  const beside = `${artifactPath}.new`;
  writeFileSync(beside, text);
  renameSync(beside, artifactPath);
  console.log(`wrote ${relative(resolve(root, ".."), artifactPath)} (${artifact.deployedBytecode.length / 2 - 1} bytes of code)`);
}
