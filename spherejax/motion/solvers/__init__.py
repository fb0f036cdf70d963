"""What diffrax lacks, as diffrax classes: Rosenbrock methods, landing on contacts, automatic choice."""
