"""What every layer shares: the scenario, entities, zones, errors."""
