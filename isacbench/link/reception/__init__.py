"""Reception by a user: channels, their estimation, decisions and bit errors."""

__all__ = ["channel", "channel_estimation", "receiver"]
