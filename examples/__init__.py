"""Programs that use hapticd as any laboratory may; README.md lists them."""
