// usage: exact_replay DIRECTORY_OR_FILE... [--mutations N] [--seed S] [--seconds T]
// Calls the fuzzer's entry point with each file, as libFuzzer's own main would, but without need of clang; then with N
// inputs made of them, for at most T seconds. Exit code 1 where there is no file, 2 for wrong arguments.

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "tests/fuzz/mutate.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

namespace {

namespace fs = std::filesystem;

struct ReplayArguments {
  std::vector<fs::path> files;
  uint64_t mutations = 0;
  uint64_t seed = 1;
  double seconds = 60;
};

// Directories in the order of their files' names: the same mutated inputs everywhere.
ReplayArguments ParseArguments(int argc, char** argv) {
  ReplayArguments arguments;
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    if (argument.starts_with("--")) {
      const char* const value = argv[++i];  // null after the last one
      char* end = nullptr;
      if (value != nullptr && argument == "--mutations") arguments.mutations = std::strtoull(value, &end, 10);
      if (value != nullptr && argument == "--seed") arguments.seed = std::strtoull(value, &end, 10);
      if (value != nullptr && argument == "--seconds") arguments.seconds = std::strtod(value, &end);
      if (end != nullptr && end != value && *end == '\0') continue;
      std::fprintf(stderr, "wrong argument %s\n", argv[i - 1]);
      std::exit(2);
    }
    const size_t before = arguments.files.size();
    if (fs::is_directory(argument)) {
      for (const auto& entry : fs::directory_iterator(argument)) arguments.files.push_back(entry.path());
      std::sort(arguments.files.begin() + before, arguments.files.end());
    } else {
      arguments.files.emplace_back(argument);
    }
  }
  return arguments;
}

std::string ReadFile(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string bytes{std::istreambuf_iterator<char>(file), {}};
  if (!file) {
    std::fprintf(stderr, "cannot read %s\n", path.c_str());
    std::exit(2);
  }
  return bytes;
}

// From memory of its exact size, so that AddressSanitizer sees what is read beyond: a string ends with one byte more.
void RunInput(const std::string& bytes) {
  const auto input = std::make_unique<uint8_t[]>(bytes.size());
  std::copy(bytes.begin(), bytes.end(), input.get());
  LLVMFuzzerTestOneInput(input.get(), bytes.size());
}

// Each input is in a file while it runs, and stays there if it ends the process, or hangs.
void RunMutations(const std::vector<std::string>& files, const ReplayArguments& arguments, const fs::path& kept) {
  using Clock = std::chrono::steady_clock;
  const auto end = Clock::now() + std::chrono::duration<double>(arguments.seconds);
  std::printf("%llu mutated inputs of seed %llu, each in %s while it runs\n",
              static_cast<unsigned long long>(arguments.mutations), static_cast<unsigned long long>(arguments.seed),
              fs::absolute(kept).c_str());
  std::fflush(stdout);
  const int file = open(kept.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  deltaray::Random random(arguments.seed);
  uint64_t count = 0;
  for (; count < arguments.mutations && Clock::now() < end; ++count) {
    const std::string input = deltaray::Mutate(files, random);
    if (pwrite(file, input.data(), input.size(), 0) != static_cast<ssize_t>(input.size()) ||
        ftruncate(file, static_cast<off_t>(input.size())) != 0) {
      std::fprintf(stderr, "cannot write %s\n", kept.c_str());
      std::exit(2);
    }
    RunInput(input);
  }
  close(file);
  fs::remove(kept);
  std::printf("%llu mutated inputs%s\n", static_cast<unsigned long long>(count),
              count < arguments.mutations ? ", then the time was over" : "");
}

}  // namespace

int main(int argc, char** argv) {
  const ReplayArguments arguments = ParseArguments(argc, argv);
  std::vector<std::string> files;
  for (const fs::path& path : arguments.files) {
    files.push_back(ReadFile(path));
    // Told before: a failure ends the process.
    std::printf("%s, %zu bytes\n", path.c_str(), files.back().size());
    std::fflush(stdout);
    RunInput(files.back());
  }
  std::printf("%zu files\n", files.size());
  if (files.empty()) return 1;
  if (arguments.mutations > 0) {
    RunMutations(files, arguments, fs::path(argv[0]).filename().concat("_input"));
  }
  return 0;
}
