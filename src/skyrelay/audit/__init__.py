"""Whether a run's folder says what its chain says: what follows from the chain is worked out and compared.

`skyrelay.chain.proof` audits a chain, this room the files beside it. What neither can tell is named as unchecked.
"""

from skyrelay.audit.folder import audit_folder, audit_node_folder

__all__ = ["audit_folder", "audit_node_folder"]
