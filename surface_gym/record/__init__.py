"""What a run tells on request: contacts, forces and energy; its files and its picture."""
