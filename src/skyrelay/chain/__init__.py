"""The contract's client, the embedded chain, nodes, the auditor."""
