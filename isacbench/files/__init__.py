"""Files that users name: checked before they are opened, read up to a limit, shown without harm."""

__all__ = ["arrays", "checked_files", "escaping", "toml_files"]
