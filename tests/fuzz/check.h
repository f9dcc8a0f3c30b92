// Ends the process where what a fuzzer found is wrong, and says what; a sanitizer then shows where.

#ifndef TESTS_FUZZ_CHECK_H_
#define TESTS_FUZZ_CHECK_H_

#include <cstdio>
#include <cstdlib>
#include <initializer_list>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/mesh/utf8.h"

namespace deltaray {

[[noreturn]] inline void FailFuzz(const std::string& what) {
  std::fprintf(stderr, "wrong: %s\n", what.c_str());
  std::abort();
}

inline void Check(bool right, absl::string_view what) {
  if (!right) FailFuzz(std::string(what));
}

// A refusal has one of these codes, and a text that may stand in a log and on a terminal.
inline void CheckRefusal(const absl::Status& status, std::initializer_list<absl::StatusCode> allowed) {
  bool known = false;
  for (const absl::StatusCode code : allowed) known = known || status.code() == code;
  Check(known, "a code that is not documented: " + status.ToString());
  Check(!status.message().empty(), "a refusal without a text: " + status.ToString());
  Check(ToValidUtf8(status.message()) == status.message(), "a refusal whose text is not clean: " + status.ToString());
}

}  // namespace deltaray

#endif  // TESTS_FUZZ_CHECK_H_
