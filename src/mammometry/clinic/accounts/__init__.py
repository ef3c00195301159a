"""How people come in: names, passwords, second factor, the hospital's own login, invitations."""
