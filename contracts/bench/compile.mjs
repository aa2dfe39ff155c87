// Compile bench/Ordering.sol with the contract's settings; JSON on stdout.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const root = resolve(dirname(fileURLToPath(import.meta.url)), "..");
const solc = createRequire(import.meta.url)("solc");
const read = (path) => ({ content: readFileSync(join(root, path), "utf8") });
const output = JSON.parse(
  solc.compile(
    JSON.stringify({
      language: "Solidity",
      sources: { "bench/Ordering.sol": read("bench/Ordering.sol"), "src/libraries/ProposalHeap.sol": read("src/libraries/ProposalHeap.sol") },
      settings: {
        ...JSON.parse(read("settings.json").content),
        outputSelection: { "*": { Ordering: ["abi", "evm.bytecode.object"] } },
      },
    }),
  ),
);
if (output.errors?.length) {
  console.error(output.errors.map((problem) => problem.formattedMessage).join("\n"));
  process.exit(1);
}
const contract = output.contracts["bench/Ordering.sol"].Ordering;
console.log(JSON.stringify({ abi: contract.abi, bytecode: contract.evm.bytecode.object }));
