"""Programs that use hapticd like any laboratory; README.md lists them."""
