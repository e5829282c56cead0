"""From readings to configurations: estimators and chains of links."""
