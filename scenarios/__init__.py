"""The built-in scenarios and suites, one TOML file each."""
