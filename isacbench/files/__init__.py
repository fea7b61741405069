"""Files that users name: checked before they are opened, read up to a limit, shown without harm."""
