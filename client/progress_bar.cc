#include "client/progress_bar.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace deltaray {
namespace {

constexpr int kBarWidth = 24;
constexpr std::chrono::milliseconds kRedrawInterval(100);

}  // namespace

ProgressBar::~ProgressBar() {
  if (!drawn_) return;
  std::fputs("\r\033[K", terminal_);
  std::fflush(terminal_);
}

void ProgressBar::Update(double fraction, absl::string_view text) {
  const auto now = std::chrono::steady_clock::now();
  if (!enabled_ || (drawn_ && now - last_drawn_ < kRedrawInterval)) return;
  drawn_ = true;
  last_drawn_ = now;
  std::string bar;
  if (fraction >= 0) {
    const int filled = static_cast<int>(std::min(fraction, 1.0) * kBarWidth);
    bar = absl::StrFormat("[%s%s] %3d %%  ", std::string(filled, '#'), std::string(kBarWidth - filled, '.'),
                          static_cast<int>(std::min(fraction, 1.0) * 100));
  }
  // Without line wrap, so that a narrow terminal cuts the line instead of scrolling.
  std::fputs(absl::StrCat("\r\033[K\033[?7l", bar, text, "\033[?7h").c_str(), terminal_);
  std::fflush(terminal_);
}

}  // namespace deltaray
