"""What estimators are made of, as pure functions on arrays."""
