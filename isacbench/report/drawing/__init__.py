"""Drawing: style, panels and places of labels that figures share."""

__all__ = ["label_layout", "panels", "style"]
