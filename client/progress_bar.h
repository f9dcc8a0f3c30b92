// A progress bar on a terminal.

#ifndef CLIENT_PROGRESS_BAR_H_
#define CLIENT_PROGRESS_BAR_H_

#include <chrono>
#include <cstdio>

#include "absl/strings/string_view.h"

namespace deltaray {

// Draws on one line, which it clears when it goes. Draws nothing where it is not enabled. Not thread-safe.
class ProgressBar {
 public:
  ProgressBar(std::FILE* terminal, bool enabled) : terminal_(terminal), enabled_(enabled) {}
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  // Shows `text` behind a bar filled by `fraction`, clamped to 0 to 1; a negative fraction shows the text alone.
  // Redraws at most ten times a second.
  void Update(double fraction, absl::string_view text);

 private:
  std::FILE* terminal_;
  bool enabled_;
  bool drawn_ = false;
  std::chrono::steady_clock::time_point last_drawn_;
};

}  // namespace deltaray

#endif  // CLIENT_PROGRESS_BAR_H_
