//! Who may do what on a daemon: registration by proof of possession, roles, short-lived signed tokens, quotas.
