"""What the radio sees: numerology, array, frame, scene, gate and echo."""
