"""What a clinic does to a capture: patients, surroundings, cameras."""
