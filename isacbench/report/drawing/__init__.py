"""Drawing: style, panels, labels and perspective that figures share."""
