"""Drawing: style, panels, labels and perspective that figures share."""

__all__ = ["label_layout", "panels", "perspective", "style"]
