"""Reception by a user: channels, their estimation, decisions and bit errors."""
