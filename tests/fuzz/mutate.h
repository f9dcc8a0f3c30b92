// Inputs made of others, so that fuzzers need not have clang's libFuzzer to look a little beyond their corpus.

#ifndef TESTS_FUZZ_MUTATE_H_
#define TESTS_FUZZ_MUTATE_H_

#include <cstdint>
#include <span>
#include <string>

#include "tests/scenes/random.h"

namespace deltaray {

// One of the files, REQUIRES: there is one, after 1 to 8 changes: bits, bytes, numbers, ranges that go, come or are
// doubled, the front of another file. No longer than 4 KiB or the file itself. The same for the same state of `random`,
// anywhere.
std::string Mutate(std::span<const std::string> files, Random& random);

}  // namespace deltaray

#endif  // TESTS_FUZZ_MUTATE_H_
