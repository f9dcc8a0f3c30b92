// Compiles nothing: its library holds the precompiled headers of tests.
