# What CI does, by the same script: `just` alone runs all of it.

# All sections of CI.
ci:
    .ci/run

# Installs what the other sections need, if it is missing.
tools:
    .ci/run tools

# The whole test suite.
test:
    .ci/run test

# Whether everything is formatted (`cargo fmt --all` formats).
fmt:
    .ci/run fmt

# clippy, warnings denied.
lint:
    .ci/run lint

# The documentation of all crates, warnings denied.
doc:
    .ci/run doc

# Licences, duplicate versions and sources of the dependencies.
deny:
    .ci/run deny

# Known vulnerabilities; needs the network for the advisory database, so CI leaves it out.
advisories:
    cargo deny check advisories

# A first run.
demo:
    cargo run --release -- train maze-small --algo ha-diiqn --seed 7
