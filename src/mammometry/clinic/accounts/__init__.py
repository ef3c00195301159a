"""How people come in. Names, passwords, second factor, the hospital's own login, invitations."""
