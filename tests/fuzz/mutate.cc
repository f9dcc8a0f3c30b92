#include "tests/fuzz/mutate.h"

#include <algorithm>
#include <cstddef>
#include <limits>

namespace deltaray {
namespace {

constexpr size_t kUsualLongest = 4096;
constexpr uint32_t kMostChanges = 8;
constexpr size_t kLongestRange = 64;

// Where readers tend to go wrong: at ends of types, signs, powers of two and their neighbours.
constexpr uint64_t kNumbers[] = {0,
                                 1,
                                 2,
                                 3,
                                 16,
                                 64,
                                 100,
                                 0x7F,
                                 0x80,
                                 0xFF,
                                 0x100,
                                 0x7FFF,
                                 0x8000,
                                 0xFFFF,
                                 0x10000,
                                 0x7F800000,  // infinity, as float
                                 0x7FC00000,  // not a number
                                 0x7FFFFFFF,
                                 0x80000000,
                                 0xFFFFFFFE,
                                 0xFFFFFFFF,
                                 0x7FF0000000000000,  // infinity, as double
                                 0x7FFFFFFFFFFFFFFF,
                                 0x8000000000000000,
                                 std::numeric_limits<uint64_t>::max()};
// What separates in texts, and what they should not hold.
constexpr char kBytes[] = {'\0', '\n', '\r', ' ', '\t', '-',    '.',    '0',
                           '9',  'e',  '/',  '#', '\\', '\x7F', '\x80', '\xFF'};

template <typename T, size_t kCount>
T OneOf(const T (&values)[kCount], Random& random) {
  return values[random.Below(kCount)];
}

struct Range {
  size_t start;
  size_t length;
};

// A short range, or now and then any; of nothing where there is nothing.
Range AnyRange(const std::string& input, Random& random) {
  const size_t start = random.Below(input.size() + 1);
  const size_t rest = input.size() - start;
  const size_t longest = random.Below(8) == 0 ? rest : std::min(rest, kLongestRange);
  return {start, random.Below(longest + 1)};
}

// Little-endian, over what is there, as far as it reaches.
void SetNumber(std::string* input, Random& random) {
  constexpr size_t kSizes[] = {2, 4, 8};
  const size_t size = std::min(OneOf(kSizes, random), input->size());
  const size_t start = random.Below(input->size() - size + 1);
  const uint64_t number = OneOf(kNumbers, random);
  for (size_t i = 0; i < size; ++i) (*input)[start + i] = static_cast<char>(number >> 8 * i);
}

void InsertBytes(std::string* input, Random& random) {
  // Drawn one after the other: arguments are evaluated in any order, and inputs must be the same everywhere.
  const uint32_t count = 1 + random.Below(16);
  const char byte_of_all = OneOf(kBytes, random);
  std::string bytes(count, byte_of_all);
  if (random.Below(2) == 0) {
    for (char& byte : bytes) byte = static_cast<char>(random.Below(256));
  }
  input->insert(random.Below(input->size() + 1), bytes);
}

void Change(std::string* input, std::span<const std::string> files, Random& random) {
  const uint32_t change = random.Below(8);
  if (input->empty() && change < 3) return InsertBytes(input, random);
  switch (change) {
    case 0:
      (*input)[random.Below(input->size())] ^= static_cast<char>(1 << random.Below(8));
      break;
    case 1:
      (*input)[random.Below(input->size())] =
          random.Below(2) == 0 ? OneOf(kBytes, random) : static_cast<char>(random.Below(256));
      break;
    case 2:
      SetNumber(input, random);
      break;
    case 3: {
      const Range range = AnyRange(*input, random);
      input->erase(range.start, range.length);
      break;
    }
    case 4: {
      const Range range = AnyRange(*input, random);
      input->insert(range.start, input->substr(range.start, range.length));
      break;
    }
    case 5:
      InsertBytes(input, random);
      break;
    case 6:
      input->resize(random.Below(input->size() + 1));
      break;
    default: {  // the front of this one, the end of another
      const std::string& other = files[random.Below(files.size())];
      input->resize(random.Below(input->size() + 1));
      input->append(other, random.Below(other.size() + 1));
    }
  }
}

}  // namespace

std::string Mutate(std::span<const std::string> files, Random& random) {
  std::string input = files[random.Below(files.size())];
  const size_t longest = std::max(kUsualLongest, input.size());
  for (uint32_t i = 1 + random.Below(kMostChanges); i > 0; --i) {
    Change(&input, files, random);
    if (input.size() > longest) input.resize(longest);
  }
  return input;
}

}  // namespace deltaray
