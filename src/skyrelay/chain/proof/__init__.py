"""What an auditor checks: the trie, headers and seals, the replay, the reference contract."""
