from pbd import ensure_initialized

ensure_initialized()  # here rather than in a fixture: test modules may make arrays while they are collected
