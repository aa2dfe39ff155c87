"""Models by content address: identifiers as IPFS gives them, blocks in a folder or behind a Kubo endpoint."""
