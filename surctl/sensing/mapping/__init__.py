"""From ranges to what stands where: contacts, and the local map."""
