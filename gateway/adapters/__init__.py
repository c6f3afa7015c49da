"""Other command sets than the gateway's own, on its public API."""
